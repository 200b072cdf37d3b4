"""Floor 7: statistics of campaigns: summary, acceptance, comparison and ranking."""

from .acceptance import (
    Decision as Decision,
    Requirement as Requirement,
    Verdict as Verdict,
    judged as judged,
)
from .alternatives import (
    Alternative as Alternative,
    Alternatives as Alternatives,
    alternatives_of as alternatives_of,
)
from .comparison import Comparison as Comparison, compared as compared
from .filter_consistency import (
    Consistency as Consistency,
    consistency as consistency,
    consistency_of as consistency_of,
)
from .ranking import rank_correlations as rank_correlations, worst_runs as worst_runs
from .summary import Summary as Summary, summarize as summarize
