"""What every wrong call is answered with: one sentence that names the argument and shows the value."""

import traceback
from pathlib import Path

import pytest

import minimd as md

FAILED_RUNS = (md.NonFiniteError, md.ConstraintError)  # of which the cause is told, and in a second line what was seen


def is_foreseen(error):
    """Whether it comes from a `raise` in minimd, and not from the inside of another library."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return bool({"minimd", "minimd_bench"} & {*Path(last.filename).parts}) and last.line.startswith("raise")


def assert_answered(call, error, *shown):
    """The call raises just this error, from a `raise` in minimd, in one sentence that contains what must be shown.
    shown : the name of the argument, and its value as the user would see it."""
    with pytest.raises(error) as caught:
        call()
    message = str(caught.value)
    assert type(caught.value) is error
    assert message.count("\n") <= (error in FAILED_RUNS), message
    assert [word for word in shown if word not in message] == [], message
    assert is_foreseen(caught.value), traceback.format_tb(caught.value.__traceback__)[-1]
    return message


def answered(*rows):
    """A test of each row: a call, its error, and what must be shown."""

    @pytest.mark.parametrize("row", rows, ids=lambda row: f"{row[1].__name__} {row[-1]}")
    def test(row):
        assert_answered(*row)

    return test
