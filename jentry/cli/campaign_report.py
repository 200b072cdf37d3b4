"""Tables and lines that the commands print about a campaign."""

from collections.abc import Iterator, Sequence

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from .._printed import in_words
from ..campaign.outputs import (
    MISS_DISTANCE,
    VELOCITY_INCREMENT,
    believed,
    is_error,
    is_of_navigation,
    peak_of,
)
from ..campaign.populations import population, sets_of
from ..flight.flight import caveat_words
from ..flight.solver import FixedStep
from ..missions.mission import Mission
from ..statistics.acceptance import Decision, Verdict
from ..statistics.intervals import CONFIDENCE, Interval
from ..statistics.miss_ellipse import MissEllipse
from ..statistics.summary import PERCENTILES, Statistics, Summary, summarize
from ..units import at_edge, degree, edge_unit
from .tables import (
    ROUNDING,
    in_digits,
    new_console,
    new_table,
    print_in_pieces,
    print_under,
)


SETS = 16
"""Least number of sets, each of the paper's size, to compare with a published value"""


def print_campaign(
    mission: Mission,
    results,
    as_published: bool,
    summary: Summary | None = None,
    full: bool = False,
) -> None:
    """Print a summary of the runs, all of it if `full`, and compare published values.

    Published values are compared if the campaign is as published and has enough sets of
    the published size. Otherwise a line describes the published campaign.
    """
    summary = summarize(results) if summary is None else summary
    print_summary(mission.name, summary, aims_of(mission), full)
    if not mission.published or summary.finite == 0:
        return
    console = new_console()
    size = mission.published_runs
    if not as_published:
        console.print(
            f"published values are of the law {mission.published_law} with the "
            f"dispersions {mission.published_dispersions}, unchanged, by plain draws"
        )
    elif results.sizes["run"] < SETS * size:
        console.print(
            f"published values are of {size} runs, and statistics vary from one set of "
            f"{size} runs to another: --runs {SETS * size} compares them with {SETS} sets"
        )
    else:
        _print_published(console, mission, results)


def aims_of(mission: Mission) -> list[str]:
    """Names in results of the peaks that a mission is tuned for besides its misses."""
    names = (scale.partition("=")[0].strip() for scale in mission.tuned_for)
    return [peak_of(name) for name in names]


def print_summary(
    name: str, summary: Summary, aims: Sequence[str] = (), full: bool = False
) -> None:
    """Print outcomes, caveats, errors and limited quantities, and acceptance.

    With `full`, print all statistics with their intervals, all limits, and circular
    errors. `aims` are further peaks in the short table, beside errors and limited
    quantities.
    """
    console = new_console()
    _print_solver(console, summary)
    for line in told_first(summary, kept_limits=full):
        console.print(line)
    if summary.statistics and not full:
        _print_aims(console, name, summary, aims)
    elif summary.statistics:
        count = summary.finite
        title = f"{name}: {count} finite flights, errors are actual minus desired"
        _print_statistics(console, title, summary.statistics)
        _print_intervals(console, summary.statistics)
    if summary.statistics:
        if summary.of_navigation:
            console.print(summary.of_navigation)
        if summary.counted_from:
            console.print(f"downrange and crossrange: {summary.counted_from}")
        if summary.caution:
            console.print(summary.caution)
    if summary.ellipse is not None and full:
        _print_ellipse(console, summary.ellipse)
    if summary.verdicts:
        _print_verdicts(console, summary.verdicts)


def _print_solver(console: Console, summary: Summary) -> None:
    """Print a solver that is not the mission's own: it changes the numbers."""
    solver = summary.campaign.get("solver")
    if solver not in (None, repr(FixedStep())):
        console.print(f"flown with {solver}, not with the mission's own steps")


def told_first(summary: Summary, kept_limits: bool = True) -> Iterator[str]:
    """Lines about how the runs ended, how many exceed a limit, caveats, and whether the
    navigation filter is consistent.

    A limit that no flight exceeds has a line only with `kept_limits`.
    """
    for outcome, (runs, left_out) in summary.outcomes.items():
        line = f"{runs} of {summary.runs} runs {outcome.message}"
        if left_out:
            line += f"; {left_out} of them left out of the statistics"
        yield line
    for limit in summary.limits:
        if not limit.beyond and not kept_limits:
            continue
        number, unit = at_edge(limit.limit, limit.unit, limit.shown_unit)
        words = f"the limit of the {in_words(limit.name)}, {float(number):g} {unit}"
        yield f"{limit.beyond} of {summary.finite} flights exceed {words}"
    for name, caveat in summary.caveats.items():
        told = caveat.flights, summary.runs, caveat.largest_share
        far = caveat.largest_distance, caveat.unit
        yield f"caveat: {caveat_words(name, *told, *far)}"
    if summary.navigation_filter is not None:
        yield summary.navigation_filter.words


_STILL = 1e-6
"""SI unit; a quantity with a smaller range over the runs counts as constant, such as the
crossrange of a flight in a plane"""

_SHOWN = 50.0, 95.0, 99.0
"""Percentiles of the short table, if no others are requested"""


def _print_aims(
    console: Console, name: str, summary: Summary, aims: Sequence[str]
) -> None:
    """Print one table of errors and limited quantities, 100 columns wide."""
    signed = {each.name: each for each in summary.statistics if not each.magnitude}
    sizes = {each.name: each for each in summary.statistics if each.magnitude}
    limits = {limit.name: limit.beyond for limit in summary.limits}
    of_all = tuple(summary.statistics[0].percentiles)
    percentiles = [p for p in of_all if of_all != PERCENTILES or p in _SHOWN]
    heads = ["", "unit", "mean", "std", *(f"{p:.10g} %" for p in percentiles)]
    heads += ["maximum", *(["over"] if limits else [])]
    rows, still, others, shown = [], [], 0, ""
    for each in signed.values():
        size = sizes.get(each.name, each)
        unsigned = MISS_DISTANCE, VELOCITY_INCREMENT
        named = *unsigned, *map(believed, unsigned), *aims, *limits
        counts = each.name in named or is_error(each.name)
        if not counts:
            others += 1
        elif each.maximum - each.minimum < _STILL:
            still.append(each.words)
        else:
            numbers = [each.mean.value, each.standard_deviation.value]
            numbers += [size.percentiles[p].value for p in percentiles]
            numbers.append(size.maximum)
            cells = [_short(number / size.shown_size) for number in numbers]
            if limits:
                beyond = limits.get(each.name)
                cells.append("" if beyond is None else f"{beyond}")
            # Below the actual error the names of the others need not repeat its name.
            of_whom, _, error = each.name.partition("_")
            below = is_of_navigation(each.name) and error == shown
            shown = shown if below else each.name
            words = f"  {of_whom}" if below else each.words
            rows.append((words, size.shown_unit, *cells))
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column(heads[0], max_width=23)
    for head in heads[1:]:
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(*row)
    console.width = max(console.width, 100)
    title = f"{name}: {summary.finite} finite flights, errors are actual minus desired"
    if rows:
        print_under(console, title, table)
        console.print("percentiles and maxima of errors are those of their magnitudes")
        if limits:
            console.print("over: flights that exceed the limit")
    if summary.finite == 1:
        console.print(
            "one flight has no statistics; its numbers: jentry report FOLDER --full"
        )
    elif still:
        console.print(f"not shown, since they do not vary: {', '.join(still)}")
    if others:
        console.print(
            f"{others} more quantities, with intervals and circular errors: "
            "jentry report FOLDER --full"
        )


def _short(number: float) -> str:
    """A number in three or four digits, in at most eight characters if it is usual."""
    size = abs(number)
    if np.isnan(number):
        return "-"
    if size < ROUNDING:
        return "0"
    if size < 1e-3:
        return f"{number:.1e}"
    if size >= 1e4:
        return f"{number:.0f}"
    return f"{number:.4g}" if size >= 0.01 else f"{number:.3g}"


def _print_statistics(
    console: Console, title: str, statistics: list[Statistics]
) -> None:
    percentiles = [f"{p:.10g} %" for p in statistics[0].percentiles]
    heads = ("", "unit", "minimum", "maximum", "mean", "std", *percentiles)
    rows = []
    for each in statistics:
        numbers = [each.minimum, each.maximum, each.mean.value]
        numbers += [each.standard_deviation.value]
        numbers += [interval.value for interval in each.percentiles.values()]
        cells = (in_digits(number / each.shown_size) for number in numbers)
        rows.append((each.words, each.shown_unit, *cells))
    print_in_pieces(console, title, heads, rows, repeated=2)


def _print_intervals(console: Console, statistics: list[Statistics]) -> None:
    percentiles = [f"{p:.10g} %" for p in statistics[0].percentiles]
    rows = []
    for each in statistics:
        intervals = each.mean, each.standard_deviation, *each.percentiles.values()
        cells = (_between(interval, each.shown_size) for interval in intervals)
        rows.append((each.words, each.shown_unit, *cells))
    title = (
        f"intervals of {CONFIDENCE:.0%}: mean and std by bootstrap, percentiles by order "
        "statistics; - where the runs are too few"
    )
    heads = ("", "unit", "mean", "std", *percentiles)
    print_in_pieces(console, title, heads, rows, repeated=2)


def _between(interval: Interval, size: float) -> str:
    if np.isnan(interval.lower) and np.isnan(interval.upper):
        return "-"
    return f"{in_digits(interval.lower / size)} … {in_digits(interval.upper / size)}"


def _print_ellipse(console: Console, ellipse: MissEllipse) -> None:
    table = new_table("", "unit", *(f"{p:.10g} %" for p in ellipse.radii))
    lengths = [radius.value for radius in ellipse.radii.values()]
    unit, size = edge_unit("m", lengths)
    table.add_row(
        "radius about the target", unit, *(in_digits(x / size) for x in lengths)
    )
    between = (_between(radius, size) for radius in ellipse.radii.values())
    table.add_row(f"its interval of {CONFIDENCE:.0%}", unit, *between)
    for words, axis in zip(("larger", "smaller"), ellipse.semi_axes, strict=True):
        axes = (in_digits(ellipse.scale(p) * axis / size) for p in ellipse.radii)
        table.add_row(f"{words} semi-axis of the ellipse", unit, *axes)
    shares = (in_digits(100.0 * share) for share in ellipse.inside.values())
    table.add_row("flights in the ellipse", "%", *shares)
    title = (
        "downrange and crossrange errors: circles about the target, and ellipses of the "
        "normal distribution with the covariance of the flights"
    )
    print_under(console, title, table)
    along, across = (in_digits(x / size) for x in ellipse.mean)
    console.print(
        f"centre of the ellipses: {along} {unit} downrange, {across} {unit} crossrange; "
        f"larger axis {in_digits(ellipse.angle / degree)} deg from downrange to "
        "the left, where crossrange is positive"
    )


def _print_verdicts(console: Console, verdicts: list[Verdict]) -> None:
    heads = ("requirement", "decision", "runs", "failures", "probability of failure")
    table = new_table(*heads)
    for verdict in verdicts:
        table.add_row(
            verdict.requirement.text,
            verdict.decision.value,
            str(verdict.runs),
            str(verdict.failures),
            f"< {verdict.bound:.3g}",
        )
    how = (
        "sequential, valid at whatever number of runs it is evaluated"
        if verdicts[0].sequential
        else "by order statistics, for a number of runs that was chosen beforehand"
    )
    print_under(console, f"acceptance, {how}", table)
    for verdict in verdicts:
        requirement = verdict.requirement
        if verdict.without_end:
            console.print(
                f"{requirement.text}: {verdict.without_end} of the failures are runs "
                "without an end or without a finite value"
            )
        if requirement.caution:
            console.print(f"{requirement.text}: {requirement.caution}")
        if verdict.decision is Decision.NOT_ENOUGH_RUNS:
            console.print(f"{requirement.text}: {_more(verdict)}")


def _more(verdict: Verdict) -> str:
    """Text about how many more runs a decision takes."""
    if verdict.more_runs is None:
        return "no number of runs that can be computed would pass"
    line = f"passes with {verdict.more_runs} more runs if none of them fails"
    if verdict.failures:
        at_rate = verdict.more_runs_at_this_rate
        line += (
            "; never at this rate of failures"
            if at_rate is None
            else f", with {at_rate} more at this rate of failures"
        )
    return line


def _print_published(console: Console, mission: Mission, results) -> None:
    size = mission.published_runs
    sets = sets_of(results, size)
    columns = "published", "mean of sets", "std of a set", "deviations", "sets below"
    table = new_table("", "unit", *columns)
    for published in mission.published:
        ours = population(published.statistic, sets)
        deviations = ours.deviations(published.value)
        table.add_row(
            published.name,
            published.unit,
            in_digits(published.value),
            in_digits(ours.mean),
            in_digits(ours.spread),
            "-" if np.isnan(deviations) else f"{deviations:+.1f}",
            f"{ours.below(published.value)} of {len(sets)}",
        )
    title = f"{len(sets)} sets of {size} runs against {mission.published_note}"
    print_under(console, title, table)
    console.print(
        "deviations: published value minus the mean of the sets, in standard deviations "
        "of a set"
    )
