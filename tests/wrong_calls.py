"""What every wrong call is answered with: one sentence that names the argument and shows the value."""

import traceback
from pathlib import Path

import pytest

import minimd as md

IN_TWO_LINES = (md.NonFiniteError, md.ConstraintError)  # of a failed run: the cause, and what was seen


def assert_answered(call, error, *shown):
    """The call raises just this error, from a `raise` in minimd, in one sentence that contains what must be shown.

    shown : the name of the argument, and its value as the user would see it.
    """
    with pytest.raises(error) as caught:
        call()
    message = str(caught.value)
    assert type(caught.value) is error
    assert message.count("\n") <= (error in IN_TWO_LINES), message
    assert [word for word in shown if word not in message] == [], message
    last = traceback.extract_tb(caught.value.__traceback__)[-1]
    own = {"minimd", "minimd_bench"} & {*Path(last.filename).parts}
    assert own, "the error comes from the inside of another library"
    assert last.line.startswith("raise"), "the error was not foreseen"
    return message
