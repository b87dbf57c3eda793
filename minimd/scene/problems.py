"""What is wrong with a scene file, one sentence for each problem: where, what it is, what it must be."""

import json
from collections.abc import Iterator
from difflib import get_close_matches
from typing import Any

from pydantic import ValidationError

from minimd.scene.section import Reading, Section, Unknown

PLAIN = {  # pydantic's words: ours
    "Input should be": "must be",
    "a valid integer": "a whole number",
    "a valid ": "a ",
    "dictionary or instance of": "table like",
    "dictionary or object to extract fields from": "table",
    "dictionary": "table",
    "List should have": "must have",
    "item after validation": "entry",
    "items after validation": "entries",
    "Value error, ": "",
}


def problems(document: dict, reading: Reading, error: ValidationError | None) -> list[str]:
    """Sentences about the unknown keys and wrong values of a document, in that order; an empty list if all is well."""
    paths = {id(table): path for path, table in _tables(document, "")}
    sentences = [_about_unknown(unknown, paths[id(unknown.table)], reading) for unknown in reading.unknown]
    meant = {(paths[id(u.table)], name) for u in reading.unknown if (name := _meant(u, reading)[1])}
    wrong: dict[str, list[str]] = {}
    for details in error.errors(include_url=False) if error else ():
        place, name, sentence = _about_value(details, document, reading)
        if (place.rpartition(".")[0], name) not in meant and not (details["type"] == "value_error" and place in paths.values() and reading.unknown):
            wrong.setdefault(place, []).append(sentence)
    if "units" in wrong:  # then all other keys look wrong too
        return [_joined(wrong["units"])]
    deepest = [place for place in wrong if not any(other.startswith(place + "[") for other in wrong)]
    return sentences + [_joined(wrong[place]) for place in deepest]


def _tables(node: Any, path: str) -> Iterator[tuple[str, dict]]:
    """All tables of a document with their paths, such as potential[0].species.Ar."""
    if isinstance(node, dict):
        yield path, node
        for key, value in node.items():
            yield from _tables(value, f"{path}.{key}" if path else key)
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from _tables(value, f"{path}[{index}]")


def _meant(unknown: Unknown, reading: Reading) -> tuple[str | None, str | None]:
    """The key that was probably meant, and its field."""
    keys = reading.sections[id(unknown.table)].keys(reading.units)
    stem = unknown.key.rpartition("_")[0] or unknown.key
    near = [key for key, (name, _) in keys.items() if name in (unknown.key, stem)] or get_close_matches(unknown.key, keys, n=1)
    return (near[0], keys[near[0]][0]) if near else (None, None)


def _about_unknown(unknown: Unknown, path: str, reading: Reading) -> str:
    keys = reading.sections[id(unknown.table)].keys(reading.units)
    where = path or "a scene"
    if unknown.twice:
        return f"{where} has {unknown.key!r} beside the same quantity in another unit; give one of them"
    near, _ = _meant(unknown, reading)
    hint = f"did you mean {near!r}? " if near else ""
    return f"{where} has no key {unknown.key!r} (= {_shown(unknown.table[unknown.key])}); {hint}Keys in {reading.units} units: {', '.join(keys)}"


def _about_value(details: Any, document: dict, reading: Reading) -> tuple[str, str | None, str]:
    """Path of a wrong value, the field where it is missing, and the sentence about it."""
    place, value, section = _written(details["loc"], document, reading)
    name = details["loc"][-1] if details["loc"] else None
    if details["type"] == "missing":
        keys = list(section.keys_of(str(name), reading.units)) if section else [str(name)]
        path = ".".join(filter(None, (place, keys[0])))
        return path, name, f"{path} is missing" + (f"; give it, or {' or '.join(keys[1:])}" if len(keys) > 1 else "; give it")
    if details["type"] == "union_tag_not_found":
        return place, None, f"{place}.type is missing; it says what kind of potential this is: 'lennard-jones', 'harmonic-bond' or 'harmonic-angle'"
    if details["type"] == "union_tag_invalid":
        return place, None, f"{place}.type must be one of {details['ctx']['expected_tags']}; {place}.type = {_shown(value['type'])}"
    if place == "potential" and isinstance(value, dict):
        return place, None, "potential must be written [[potential]], with two brackets, because a scene can have several; it is [potential]"
    words = details["msg"]
    for theirs, ours in PLAIN.items():
        words = words.replace(theirs, ours)
    words = words.partition(" after validation")[0]
    return place, None, f"{place} {words}".strip() if isinstance(value, dict) else f"{place} {words}; {place} = {_shown(value)}"


def _written(loc: tuple, document: dict, reading: Reading) -> tuple[str, Any, type[Section] | None]:
    """Path, value and section class at one of pydantic's locations, with the keys and values as they stand in the file."""
    path, node, section = "", document, reading.sections.get(id(document))
    for step in loc:
        if isinstance(node, list) and isinstance(step, int):
            path, node = f"{path}[{step}]", node[step]
        elif isinstance(node, dict):
            keys = section.keys_of(step, reading.units) if section and step in section.model_fields else [step]
            key = next((key for key in keys if key in node), None)
            if key is None:
                continue
            path, node = f"{path}.{key}" if path else key, node[key]
        section = reading.sections.get(id(node))
    return path, node, section


def _joined(sentences: list[str]) -> str:
    """Sentences about one value that may be of several kinds: "x must be a boolean; x = 3", "x must be a list; x = 3"."""
    first, *others = dict.fromkeys(sentences)
    for other in others:
        head, _, tail = first.partition(";")
        first = f"{head} or {other.partition(' must be ')[2].partition(';')[0]};{tail}" if " must be " in other else first
    return first


def _shown(value: Any) -> str:
    """A value as it stands in the file, shortened."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."
