"""The problems of a scene file, one sentence for each: the place, the value found there, and what is expected."""

import json
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import ValidationError

from minimd.scene.section import UNKNOWN, Keys, Reading, Section, sections_below

PLAIN = {  # words of pydantic: words of minimd
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
EDGES = "give all three edges, 0 along a direction that does not repeat, as of a slab"
MOST = 20  # problems that are told
OF_MASSES = (
    "masses are those of the element or of the structure file, 1 in LJ units, and always positive; "
)
THREE = {  # lists of the wrong length: what to write
    "structure.cell": f": {EDGES}: [20, 20, 0] with pbc = [true, true, false]",
    "structure.repeat": ": give three numbers of unit cells, such as [5, 5, 5]",
    "structure.pbc": ": give one for all directions, or three, as of a slab: [true, true, false]",
}

RAMP = (
    ": give one number, or two, from which and to which it goes during the run; for several ramps go on from its run "
    "with minimd resume run.h5md --scene cooler.toml, or write it in Python"
)


def problems(reading: Reading, error: ValidationError) -> list[str]:
    """Sentences about the errors that pydantic found in a document, in the same order, one for each place."""
    errors = error.errors(include_url=False)
    n_more = len(errors) - MOST
    errors = errors[:MOST]
    unknown = [details["loc"] for details in errors if details["type"] == "extra_forbidden"]
    meant = {(*loc[:-1], _near(loc, reading)[1]) for loc in unknown}
    wrong: dict[str, list[str]] = {}

    for details in errors:
        if details["type"] != "missing" or details["loc"] not in meant:
            place, sentence = _problem(details, reading)
            wrong.setdefault(place, []).append(sentence)

    if "units" in wrong:  # then all other keys seem wrong, too
        wrong = {"units": wrong["units"]}
    lines = []

    for place, sentences in wrong.items():
        inside = (f"{place}[", f"{place}.")
        if not any(other.startswith(inside) for other in wrong):
            lines.append(_joined(sentences))

    if n_more > 0:
        lines.append(f"there are {n_more} other problems")
    return lines


def _problem(details: Any, reading: Reading) -> tuple[str, str]:
    """The path of a problem, and the sentence about it."""
    loc = details["loc"]
    kind = details["type"]
    place, value, known = _written(loc, reading)
    if kind == "extra_forbidden":
        return f"{place}.{loc[-1]}", _about_key(loc, reading)
    if kind == "missing":
        keys = _keys_of(loc[-1], known)
        path = f"{place}.{keys[0]}".removeprefix(".")
        return path, " or ".join([f"{path} is missing; give it", *keys[1:]])

    if kind == "union_tag_not_found":
        fields = [section.model_fields for section in sections_below(Section)]
        tags = [get_args(keys["type"].annotation)[0] for keys in fields if "type" in keys]
        *kinds, last = map(repr, tags)
        sentence = f"is missing; give the kind of the potential: {', '.join(kinds)} or {last}"
        return place, f"{place}.type {sentence}"

    if kind == "union_tag_invalid":
        sentence = f"must be one of {details['ctx']['expected_tags']}"
        return place, f"{place}.type {sentence}; {place}.type = {_shown(value['type'])}"
    if kind == "model_type" and not isinstance(value, dict):
        sections = {section.__name__: section for section in sections_below(Section)}
        keys_of_section = ", ".join(sections[details["ctx"]["class_name"]].keys(reading.units))
        sentence = f"must be a table with the keys {keys_of_section}"
        return place, f"{place} {sentence}; {place} = {_shown(value)}"

    if place == "potential" and isinstance(value, dict):
        return (
            place,
            "potential must be written [[potential]], because a scene can have several; it is [potential]",
        )

    sentence = details["msg"]
    for theirs, ours in PLAIN.items():
        sentence = sentence.replace(theirs, ours)
    sentence = f"{place} {sentence.partition(' after validation')[0]}".strip()
    if not isinstance(value, dict):
        sentence += f"; {place} = {_shown(value)}"
    is_of_entry = place.endswith("]") or (isinstance(value, list) and len(value) == 3)
    if not is_of_entry:
        sentence += THREE.get(".".join(map(str, loc[:2])), "")
    if isinstance(value, list) and "dynamics" in loc and "temperature" in loc:
        sentence += RAMP
    return place, sentence


def _about_key(loc: tuple, reading: Reading) -> str:
    """The sentence about a key that a section does not know, or that gives a quantity for the second time."""
    place, table, keys = _written(loc, reading)
    key = loc[-1].removeprefix(UNKNOWN)
    if key in keys:
        return f"{place} has {key!r} and the same quantity in another unit; give only one of them"
    inside = []
    for section, entry in {} if place else reading.document.items():
        for known, (name, _) in reading.keys(entry).items():
            if key in (known, name):
                inside.append(f"{section}.{known}")
    near = " or ".join(inside) or _near(loc, reading)[0]
    hint = f"did you mean {near!r}? " if near else ""
    if key.startswith("mass"):
        hint = OF_MASSES
    fault = f"{place or 'a scene'} has no key {key[:60]!r} (= {_shown(table[key])})"
    return f'{fault}; {hint}Keys with units = "{reading.units}": {", ".join(keys)}'


def _near(loc: tuple, reading: Reading) -> tuple[str | None, str | None]:
    """The known key that is most similar to an unknown one, and its field; None, None if none is similar."""
    keys = _written(loc, reading)[2]
    key = loc[-1].removeprefix(UNKNOWN)
    stem = key.rpartition("_")[0] or key
    near = [known for known, (name, _) in keys.items() if name in (key, stem)]
    for known in near or get_close_matches(key, keys, n=1):
        return known, keys[known][0]
    return None, None


def _keys_of(name: Any, keys: Keys) -> list[str]:
    """The keys of a field; its name if there is none."""
    return [key for key, (field, _) in keys.items() if field == name] or [name]


def _written(loc: tuple, reading: Reading) -> tuple[str, Any, Keys]:
    """Path and value at a location of pydantic, as written in the file, as far as it goes; the keys allowed there."""
    path = ""
    node: Any = reading.document
    for step in loc:
        if isinstance(node, list) and isinstance(step, int):
            path = f"{path}[{step}]"
            node = node[step]
        elif isinstance(node, dict):
            keys = [key for key in _keys_of(step, reading.keys(node)) if key and key in node]
            if keys:
                path = f"{path}.{keys[0]}".removeprefix(".")
                node = node[keys[0]]
    return path, node, reading.keys(node)


def _joined(sentences: list[str]) -> str:
    """One from several: "x must be a table; x = 3", "x must be a list; x = 3": "x must be a table or a list; x = 3"."""
    first, *others = dict.fromkeys(sentences)
    head, semicolon, tail = first.partition(";")
    for other in others:
        _, must, demand = other.partition(" must be ")
        if must:
            head += f" or {demand.partition(';')[0]}"
    return head + semicolon + tail


def _shown(value: Any) -> str:
    """A value as written in the file, shortened."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."
