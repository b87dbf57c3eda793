"""The problems of a scene file, one sentence for each: the place, the value found there, and what is expected."""

import json
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import ValidationError

from minimd.scene.section import UNKNOWN, Keys, Reading, Section, sections_below

PLAIN = {  # words of pydantic: words of minimd
    "Input should be": "must be", "a valid integer": "a whole number", "a valid ": "a ",
    "dictionary or instance of": "table like", "dictionary or object to extract fields from": "table",
    "dictionary": "table", "List should have": "must have", "item after validation": "entry",
    "items after validation": "entries", "Value error, ": "",
}  # fmt: skip
EDGES = "give all three edges, 0 along a direction that does not repeat, as of a slab"
MOST = 20  # problems that are told
OF_MASSES = (
    "masses are those of the element or of the structure file, 1 in LJ units, and always positive; "
)
THREE = {  # lists of the wrong length: what to write
    ("structure", "cell"): f": {EDGES}: [20, 20, 0] with pbc = [true, true, false]",
    ("structure", "repeat"): ": give three numbers of unit cells, such as [5, 5, 5]",
    (
        "structure",
        "pbc",
    ): ": give one for all directions, or three, as of a slab: [true, true, false]",
}


def problems(reading: Reading, error: ValidationError) -> list[str]:
    """Sentences about the errors that pydantic found in a document, in the same order, one for each place."""
    every = error.errors(include_url=False)
    found = every[:MOST]
    unknown = [details["loc"] for details in found if details["type"] == "extra_forbidden"]
    meant = {(*loc[:-1], _near(loc, reading)[1]) for loc in unknown}
    wrong: dict[str, list[str]] = {}
    for details in found:
        if details["type"] != "missing" or details["loc"] not in meant:
            place, sentence = _told(details, reading)
            wrong.setdefault(place, []).append(sentence)
    if "units" in wrong:  # then all other keys seem wrong, too
        wrong = {"units": wrong["units"]}
    inside = [
        place
        for place in wrong
        if any(other.startswith((f"{place}[", f"{place}.")) for other in wrong)
    ]
    others = [f"there are {len(every) - MOST} other problems"] * (len(every) > MOST)
    return [
        _joined(sentences) for place, sentences in wrong.items() if place not in inside
    ] + others


def _told(details: Any, reading: Reading) -> tuple[str, str]:
    """The path of a problem, and the sentence about it."""
    loc = details["loc"]
    kind = details["type"]
    place, value, known = _written(loc, reading)
    if kind == "extra_forbidden":
        return f"{place}.{loc[-1]}", _about_key(loc, reading)
    if kind == "missing":
        keys = [key for key, (name, _) in known.items() if name == loc[-1]] or [str(loc[-1])]
        path = f"{place}.{keys[0]}".removeprefix(".")
        return path, " or ".join([f"{path} is missing; give it", *keys[1:]])
    if kind == "union_tag_not_found":
        types = (
            one.model_fields["type"]
            for one in sections_below(Section)
            if "type" in one.model_fields
        )
        *kinds, last = (repr(get_args(one.annotation)[0]) for one in types)
        return (
            place,
            f"{place}.type is missing; give the kind of the potential: {', '.join(kinds)} or {last}",
        )
    if kind == "union_tag_invalid":
        allowed = f"must be one of {details['ctx']['expected_tags']}"
        return place, f"{place}.type {allowed}; {place}.type = {_shown(value['type'])}"
    if kind == "model_type" and not isinstance(value, dict):
        section = next(
            one for one in sections_below(Section) if one.__name__ == details["ctx"]["class_name"]
        )
        wanted = ", ".join(section.keys(reading.units))
        return place, f"{place} must be a table with the keys {wanted}; {place} = {_shown(value)}"
    if place == "potential" and isinstance(value, dict):
        return (
            place,
            "potential must be written [[potential]], because a scene can have several; it is [potential]",
        )
    words = details["msg"]
    for theirs, ours in PLAIN.items():
        words = words.replace(theirs, ours)
    words = words.partition(" after validation")[0]
    # or the fault is in an entry
    is_whole = place.endswith("]") or (isinstance(value, list) and len(value) == 3)
    hint = "" if is_whole else THREE.get(loc[:2], "")
    given = "" if isinstance(value, dict) else f"; {place} = {_shown(value)}"
    return place, f"{place} {words}".strip() + given + hint


def _about_key(loc: tuple, reading: Reading) -> str:
    """The sentence about a key that a section does not know, or that gives a quantity for the second time."""
    place, table, keys = _written(loc, reading)
    key = loc[-1].removeprefix(UNKNOWN)
    if key in keys:
        return f"{place} has {key!r} and the same quantity in another unit; give only one of them"
    all_keys = [(name, reading.keys(one)) for name, one in reading.document.items() if not place]
    inside = [f"{name}.{one}" for name, has in all_keys for one in has if key in (one, has[one][0])]
    known = f'Keys with units = "{reading.units}":'
    near = " or ".join(inside) or _near(loc, reading)[0]
    hint = OF_MASSES if key.startswith("mass") else f"did you mean {near!r}? " if near else ""
    return f"{place or 'a scene'} has no key {key[:60]!r} (= {_shown(table[key])}); {hint}{known} {', '.join(keys)}"


def _near(loc: tuple, reading: Reading) -> tuple[str | None, str | None]:
    """The known key that is most similar to an unknown one, and its field; None, None if none is similar."""
    keys = _written(loc, reading)[2]
    key = loc[-1].removeprefix(UNKNOWN)
    stem = key.rpartition("_")[0] or key
    near = [one for one, (name, _) in keys.items() if name in (key, stem)] or get_close_matches(
        key, keys, n=1
    )
    return (near[0], keys[near[0]][0]) if near else (None, None)


def _written(loc: tuple, reading: Reading) -> tuple[str, Any, Keys]:
    """Path and value at a location of pydantic, as written in the file, as far as it goes; the keys allowed there."""
    path = ""
    node = reading.document
    for step in loc:
        if isinstance(node, list) and isinstance(step, int):
            path = f"{path}[{step}]"
            node = node[step]
        elif isinstance(node, dict):
            keys = [key for key, (name, _) in reading.keys(node).items() if name == step] or [step]
            if key := next((key for key in keys if key in node), None):
                path = f"{path}.{key}".removeprefix(".")
                node = node[key]
    return path, node, reading.keys(node)


def _joined(sentences: list[str]) -> str:
    """One from several: "x must be a table; x = 3", "x must be a list; x = 3": "x must be a table or a list; x = 3"."""
    first, *others = dict.fromkeys(sentences)
    head, semicolon, tail = first.partition(";")
    also = (
        other.partition(" must be ")[2].partition(";")[0]
        for other in others
        if " must be " in other
    )
    return " or ".join((head, *also)) + semicolon + tail


def _shown(value: Any) -> str:
    """A value as written in the file, shortened."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."
