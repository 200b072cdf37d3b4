"""Errors of stored campaigns."""


class CampaignError(Exception):
    """A campaign folder that cannot be used as it is; the message says what to do."""
