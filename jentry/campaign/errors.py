"""Errors of stored campaigns and of clusters."""


class CampaignError(Exception):
    """A campaign folder that cannot be used. The message says what to do."""


class ClusterError(Exception):
    """A cluster that is not there, is lost, or differs from this process."""
