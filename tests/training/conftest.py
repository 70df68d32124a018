"""What the tests of runs share."""

import signal
import warnings

import pytest


@pytest.fixture
def as_the_command_is():
    """Warnings are no errors, and an interruption is Python's own again when Lightning has taken
    it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
    signal.signal(signal.SIGINT, signal.default_int_handler)
