"""A progress bar on terminals, a line now and then elsewhere if asked for, nothing otherwise."""

import sys
from types import TracebackType

TENTHS = 10


class Progress:
    """Shows how much of n_steps is done, on standard error.

    show : True for a bar on a terminal and ten lines elsewhere; False for nothing; None for a bar on a terminal only.
    """

    def __init__(self, n_steps: int, label: str, show: bool | None = None) -> None:
        terminal = sys.stderr is not None and sys.stderr.isatty()
        self._n_steps, self._label = n_steps, label
        self._lines = bool(show) and not terminal
        self._done = 0
        self._bar = None
        if terminal and show is not False:
            from tqdm import tqdm

            self._bar = tqdm(total=n_steps, desc=label, unit="step", unit_scale=True, file=sys.stderr)

    def advance_to(self, done: int) -> None:
        """The run has made so many steps."""
        if self._bar is not None:
            self._bar.update(done - self._done)
        elif self._lines and done * TENTHS // self._n_steps > self._done * TENTHS // self._n_steps:
            print(f"{self._label}: step {done} of {self._n_steps}", file=sys.stderr, flush=True)
        self._done = done

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.close()
