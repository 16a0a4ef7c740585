"""Errors of trainings."""

from eitbench.scenarios.errors import EitbenchError


class TrainingInterruptedError(EitbenchError):
    """The training was stopped by the user; finished epochs are stored."""


class DivergedError(EitbenchError):
    """A loss is not finite; the state after the last good epoch is stored."""
