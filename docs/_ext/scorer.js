/* Of pages that a search finds alike, those that explain come before examples, lessons and the reference. */
var Scorer = {
  score: ([page, , , , found]) => found - (/^(gallery|course|reference|changes)/.test(page) ? 2 : 0),
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 15, 1: 5, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
