import members
import pytest


@pytest.fixture(scope="session")
def done(tmp_path_factory):
    """The table of an ensemble that nothing has disturbed."""
    return members.run(tmp_path_factory.mktemp("done"))


@pytest.fixture(scope="session")
def done_by_hand(tmp_path_factory):
    """That of one whose members run by a function of the user's."""
    return members.run(tmp_path_factory.mktemp("by_hand"), run=members.in_own_file)
