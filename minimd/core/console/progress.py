"""How much of a long computation is done: a bar on a terminal or in a notebook, ten lines elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from minimd.core.compiled.terminal import is_terminal, tell
from minimd.core.console.words import shown

TENTHS = 10


@contextmanager
def progress_of(
    end: int | None, label: str, show: bool | None = None, unit: str = "step", start: int = 0
) -> Iterator[Callable[..., Any]]:
    """Show on standard error, or in a notebook, how much of the way from start to end is done; yields a function to be
    called with the step that is reached, and perhaps another end.
    end : None if it is not known.
    unit : what is counted, if not steps.
    show : True for a bar on a terminal or in a notebook, and ten lines elsewhere; False for nothing; None for a bar
        where one is possible. ValueError for anything else."""
    if not (show is None or isinstance(show, bool)):
        raise ValueError(f"progress must be True or False; progress = {shown(show)}")
    tenths = 0

    def tell_tenths(done: int, to: int | None = None) -> None:
        nonlocal tenths, end
        end = to or end
        if show and end is not None and (done - start) * TENTHS // (end - start) > tenths:
            tenths = (done - start) * TENTHS // (end - start)
            tell(f"{label}: {unit} {done} of {end}")

    if show is False or not (is_terminal() or in_notebook()):
        yield tell_tenths
        return
    from tqdm.auto import tqdm

    style: dict[str, Any] = {"unit": unit, "unit_scale": True, "file": sys.stderr}
    with tqdm(total=end, initial=start, desc=label, **style) as bar:

        def update(done: int, to: int | None = None) -> None:
            bar.total = to or bar.total
            bar.update(done - bar.n)

        yield update


def in_notebook() -> bool:
    """Whether this is the process of a notebook, where IPython talks to its user through a kernel."""
    ipython = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(ipython, "kernel")
