"""The warning that a result has caveats."""


class ResultWarning(UserWarning):
    """A warning that the result states as well: `Flight.caveats`, `Tuned.remarks`."""
