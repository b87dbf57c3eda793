"""Scales of the house: tokens, air between them, lines that `import minimd` loads, names, sizes of files, functions.

`python tests/house/test_scales.py` prints the tokens and lines of each room. A change that needs
more raises the limit, and its commit says what that buys.
"""

import ast
import io
import tokenize
from collections import Counter, defaultdict
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
PACKAGE = REPOSITORY / "minimd"
MOST_TOKENS, MOST_TOKENS_OF_CORE = 401_500, 227_200
DENSEST_ROOM, DENSEST = 7.0, 6.2  # tokens on a line
MOST_HIDDEN = 0.01  # statements more than `a, b, c = x, y, z` shows, of all statements
MOST_LINES_OF_FACE = 300
WIDEST, LONGEST_FILE, LONGEST_FUNCTION = 120, 700, 60
NO_TOKENS = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
NEW_LINE = {tokenize.NEWLINE, tokenize.INDENT, tokenize.NL, tokenize.DEDENT, None}


@cache
def sources(*folders):
    files = [file for folder in folders for file in (REPOSITORY / folder).rglob("*.py")]
    return {file.relative_to(REPOSITORY): file.read_text(encoding="utf-8") for file in files}


@cache
def nodes_of(text):
    return [*ast.walk(ast.parse(text))]


@cache
def tokens(text):
    """Of code, without comments and docstrings: what there is to read."""
    count, before = 0, None
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            continue
        is_docstring = token.type == tokenize.STRING and before in NEW_LINE
        count += token.type not in NO_TOKENS and not is_docstring
        before = token.type
    return count


def room_of(place):
    """minimd/core/forces/forces.py is of the room core/forces, minimd/view/page.py of view."""
    folders = place.parts[1:-1]
    return "/".join(folders[:2] if folders[:1] == ("core",) else folders[:1]) or "face"


def loaded_with(module):
    """The modules that the import of a module loads, by what stands at the top of each."""
    modules = {".".join(place.with_suffix("").parts).removesuffix(".__init__"): place for place in sources("minimd")}
    loaded, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        if name in loaded or name not in modules:
            continue
        loaded.add(name)
        waiting.append(name.rpartition(".")[0])
        for node in ast.parse(sources("minimd")[modules[name]]).body:
            if isinstance(node, ast.ImportFrom):
                waiting += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            elif isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names]
    return {name: modules[name] for name in loaded}


def test_tokens_keep_to_their_budget():
    count = {place: tokens(text) for place, text in sources("minimd").items()}
    assert sum(count.values()) <= MOST_TOKENS
    assert sum(n for place, n in count.items() if room_of(place).startswith("core/")) <= MOST_TOKENS_OF_CORE


def test_there_is_air_between_the_words():
    of_tokens, of_lines = scales()
    assert {room: n / of_lines[room] for room, n in of_tokens.items() if n > DENSEST_ROOM * of_lines[room]} == {}
    assert of_tokens.total() <= DENSEST * of_lines.total()


def test_a_line_is_a_statement():
    """Parallel assignment is for what belongs together: coordinates, a swap."""
    nodes = [node for text in sources("minimd").values() for node in nodes_of(text)]
    statements = sum(isinstance(node, ast.stmt) for node in nodes)
    tuples = [node.value for node in nodes if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple)]
    assert sum(len(value.elts) - 1 for value in tuples if isinstance(value, ast.Tuple)) <= MOST_HIDDEN * statements


def test_importing_minimd_loads_few_lines():
    assert sum(sources("minimd")[place].count("\n") for place in loaded_with("minimd").values()) <= MOST_LINES_OF_FACE


def test_no_class_of_the_core_shares_its_name_with_one_in_another_file():
    places = defaultdict(set)
    for place, text in sources("minimd").items():
        for node in nodes_of(text):
            if isinstance(node, ast.ClassDef):
                places[node.name].add(place)
    shared = {name for name, found in places.items() if len(found) > 1 and any("core" in one.parts for one in found)}
    assert shared == set()


def test_lines_files_and_functions_keep_to_their_size():
    texts = sources("minimd", "tests", "examples")
    assert [place for place, text in texts.items() if max(map(len, text.splitlines()), default=0) > WIDEST] == []
    assert [place for place, text in sources("minimd", "tests").items() if text.count("\n") > LONGEST_FILE] == []
    for place, text in sources("minimd").items():
        for node in nodes_of(text):
            if isinstance(node, ast.FunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                length = body[-1].end_lineno - body[0].lineno + 1 if body else 0
                assert length <= LONGEST_FUNCTION, f"{place}: {node.name} has {length} lines"


@cache
def scales():
    """Tokens and lines of each room."""
    of_tokens, of_lines = Counter(), Counter()
    for place, text in sources("minimd").items():
        of_tokens[room_of(place)] += tokens(text)
        of_lines[room_of(place)] += text.count("\n")
    return of_tokens, of_lines


if __name__ == "__main__":
    of_tokens, of_lines = scales()
    for room, n in [*of_tokens.most_common(), ("all", of_tokens.total())]:
        n_lines = of_lines.total() if room == "all" else of_lines[room]
        print(f"{room:22}{n:8} tokens{n_lines:7} lines{n / n_lines:6.1f}")
