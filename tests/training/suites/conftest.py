"""What the tests of the application's suites share with those of evaluations."""

from tests.evaluation.conftest import known

__all__ = ["known"]
