"""What wrong and senseless calls are answered with: one sentence that names the argument and shows the value."""

import traceback
import warnings
from collections import Counter
from pathlib import Path

import pytest

import minimd as md

FAILED_RUNS = (md.NonFiniteError, md.ConstraintError)  # of which the cause is told, and in a second line what was seen
SENTENCES = (ValueError, TypeError, FileNotFoundError, FileExistsError, PermissionError, *FAILED_RUNS)


def is_foreseen(error):
    """Whether it comes from a `raise` in minimd, and not from the inside of another library."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return "minimd" in Path(last.filename).parts and last.line.startswith("raise")


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


def answer_of(call, is_senseless, has_several_problems=False):
    """The name of the exception, or "result"; words that are no identifier say what is wrong with it."""
    try:
        with warnings.catch_warnings(action="ignore"):
            warnings.simplefilter("error", RuntimeWarning)  # arithmetic that was not foreseen
            call()
    except SENTENCES as error:
        if str(error).count("\n") > isinstance(error, FAILED_RUNS) and not has_several_problems:
            return f"more than a sentence: {error}"
        if not is_foreseen(error):
            return f"not foreseen: {type(error).__name__}: {error}{traceback.format_tb(error.__traceback__)[-1]}"
        return type(error).__name__
    except Exception as error:
        return f"wrong exception: {type(error).__name__}: {error}"
    return "accepted though senseless" if is_senseless else "result"


def assert_right(answers):
    """All of some pairs, words about a call and the answer to it, are right; results and refusals are among them."""
    answers = list(answers)
    wrong = [f"{told}: {answer}" for told, answer in answers if not answer.isidentifier()]
    assert not wrong, "\n".join(wrong[:20])
    found = Counter(answer for _, answer in answers)
    assert found["result"] > 0.05 * len(answers)
    assert found["ValueError"] > 0.3 * len(answers)
