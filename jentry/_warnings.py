"""The warning that a result has something to say."""


class ResultWarning(UserWarning):
    """What a result says of itself as well: `Flight.caveats`, `Tuned.remarks`."""
