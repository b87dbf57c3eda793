"""Says which Python minimd needs, before pip looks for packages; everything else is in pyproject.toml."""

import sys

from setuptools import setup

if sys.version_info < (3, 11):  # noqa: UP036 - pip looks for packages first, and complains of theirs
    sys.exit("minimd needs Python 3.11 or newer; this is Python " + sys.version.split()[0])
setup()
