"""Errors of stored campaigns, and of the machines that fly them."""


class CampaignError(Exception):
    """A campaign folder that cannot be used as it is; the message says what to do."""


class ClusterError(Exception):
    """A cluster that is not there, is lost, or is not as this process."""
