"""The class of the answer to a call that may make no sense."""

import traceback
import warnings
from collections import Counter

from wrong_calls import FAILED_RUNS, is_foreseen

SENTENCES = (ValueError, TypeError, FileNotFoundError, FileExistsError, PermissionError, *FAILED_RUNS)


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
