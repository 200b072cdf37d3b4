"""A campaign as one self-contained page of HTML, with its summary and its figures."""

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape

from .._printed import in_words
from ..statistics.intervals import CONFIDENCE, METHODS, Interval
from ..statistics.miss_ellipse import MissEllipse
from ..statistics.summary import Summary
from ..units import degree, edge_unit
from .campaign_report import told_first
from .tables import in_digits


_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
  max-width: 1500px; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.5rem; margin-bottom: 0.2rem; }
h2 { font-size: 1.15rem; margin-top: 2rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums;
  font-size: 0.8rem; }
th, td { padding: 0.2rem 0.4rem; text-align: right; border-bottom: 1px solid #e6e6e6;
  white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
td small { display: block; color: #6e6e6e; font-size: 0.7rem; }
.passes { color: #00704f; } .fails { color: #b02a00; } .not { color: #8a5a00; }
.figures { display: grid; gap: 1rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 34rem), 1fr)); }
figure { margin: 0; } img { max-width: 100%; height: auto; }
figcaption, .note { color: #6e6e6e; font-size: 0.86rem; }
"""


def page_of(title: str, summary: Summary, figures: Mapping[str, bytes]) -> str:
    """The page as HTML.

    **Arguments:**

    - `title`: title of the mission.
    - `figures`: contents of png files by name, in the order in which they are shown.
    """
    sections = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="note">{escape(_flown(summary))}</p>',
        _outcomes(summary),
        _acceptance(summary),
        _statistics(summary),
        "" if summary.ellipse is None else _ellipse(summary.ellipse),
        html_figures(figures),
    ]
    return page_around(title, sections)


def page_around(title: str, sections: Iterable[str]) -> str:
    """A page of HTML that needs no other file. Empty sections are left out."""
    body = "\n".join(section for section in sections if section)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        # Without an icon in the page a browser would request one from a server.
        '<link rel="icon" href="data:,">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def _flown(summary: Summary) -> str:
    """Line that identifies the campaign."""
    campaign = summary.campaign
    names = ("mission", "law", "case", "world", "variant", "seed")
    told = [f"{n} {campaign[n]}" for n in names if campaign.get(n) is not None]
    versions = campaign.get("versions", {})
    told += [
        f"{name} {versions[name]}" for name in ("jentry", "jax") if name in versions
    ]
    return ", ".join(told)


def _outcomes(summary: Summary) -> str:
    items = "\n".join(f"<li>{escape(line)}</li>" for line in told_first(summary))
    return f"<h2>Outcomes</h2>\n<ul>\n{items}\n</ul>"


def _acceptance(summary: Summary) -> str:
    if not summary.verdicts:
        return ""
    heads = ("requirement", "decision", "runs", "failures", "probability of failure")
    rows = []
    for verdict in summary.verdicts:
        decision = verdict.decision.value
        rows.append(
            (
                escape(verdict.requirement.text),
                f'<b class="{decision.split()[0]}">{decision}</b>',
                str(verdict.runs),
                str(verdict.failures),
                escape(f"< {verdict.bound:.3g}"),
            )
        )
    kind = "sequential" if summary.verdicts[0].sequential else "order statistics"
    cautions = [v.requirement.caution for v in summary.verdicts]
    notes = "".join(
        f'<p class="note">{escape(text)}</p>'
        for text in dict.fromkeys(cautions)
        if text
    )
    return f"<h2>Acceptance ({kind})</h2>\n{html_table(heads, rows)}{notes}"


def _statistics(summary: Summary) -> str:
    if not summary.statistics:
        return ""
    percentiles = [f"{p:.10g} %" for p in summary.statistics[0].percentiles]
    heads = ("", "unit", "minimum", "maximum", "mean", "std", *percentiles)
    rows = []
    for each in summary.statistics:
        size = each.shown_size
        extremes = (in_digits(x / size) for x in (each.minimum, each.maximum))
        intervals = each.mean, each.standard_deviation, *each.percentiles.values()
        cells = (_cell(interval, size) for interval in intervals)
        rows.append((escape(each.words), escape(each.shown_unit), *extremes, *cells))
    navigation = f"{summary.of_navigation}. " if summary.of_navigation else ""
    return (
        f"<h2>Statistics of {summary.finite} finite flights</h2>\n"
        f"{html_table(heads, rows)}"
        f'<p class="note">Errors are actual minus desired. {navigation}Small: intervals of '
        f"{CONFIDENCE:.0%}; mean and standard deviation by "
        f"{escape(METHODS['mean'])}, percentiles by {escape(METHODS['percentiles'])}; "
        "none where the runs are too few."
        f"{' Note: ' + escape(summary.caution) + '.' if summary.caution else ''}</p>"
    )


def _ellipse(ellipse: MissEllipse) -> str:
    lengths = [radius.value for radius in ellipse.radii.values()]
    unit, size = edge_unit("m", lengths)
    heads = ("", "unit", *(f"{p:.10g} %" for p in ellipse.radii))
    rows = [
        (
            "radius about the target",
            unit,
            *(_cell(radius, size) for radius in ellipse.radii.values()),
        )
    ]
    for words, axis in zip(("larger", "smaller"), ellipse.semi_axes, strict=True):
        axes = (in_digits(ellipse.scale(p) * axis / size) for p in ellipse.radii)
        rows.append((f"{words} semi-axis of the ellipse", unit, *axes))
    shares = (in_digits(100.0 * share) for share in ellipse.inside.values())
    rows.append(("flights in the ellipse", "%", *shares))
    along, across = (in_digits(x / size) for x in ellipse.mean)
    return (
        f"<h2>Downrange and crossrange errors</h2>\n{html_table(heads, rows)}"
        f'<p class="note">Centre of the ellipses: {along} {unit} downrange, {across} '
        f"{unit} crossrange; larger axis {in_digits(ellipse.angle / degree)} deg from "
        "downrange to the left, where crossrange is positive. The ellipses are of the "
        "normal distribution with the covariance of the flights.</p>"
    )


def html_figures(figures: Mapping[str, bytes]) -> str:
    drawn = []
    for name, contents in figures.items():
        words = escape(in_words(name))
        source = base64.b64encode(contents).decode()
        drawn.append(
            f'<figure><img alt="{words}" src="data:image/png;base64,{source}">'
            f"<figcaption>{words}</figcaption></figure>"
        )
    if not drawn:
        return ""
    body = "\n".join(drawn)
    return f'<h2>Figures</h2>\n<div class="figures">\n{body}\n</div>'


def _cell(interval: Interval, size: float) -> str:
    bounds = interval.lower / size, interval.upper / size
    value = in_digits(interval.value / size)
    if all(math.isnan(bound) for bound in bounds):
        return value
    return f"{value}<small>{in_digits(bounds[0])} … {in_digits(bounds[1])}</small>"


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Table as HTML. Heads are plain text, cells are HTML."""
    first = "".join(f"<th>{escape(head)}</th>" for head in heads)
    lines = ("".join(f"<td>{cell}</td>" for cell in row) for row in rows)
    body = "\n".join(f"<tr>{line}</tr>" for line in lines)
    return f'<div class="wide"><table>\n<tr>{first}</tr>\n{body}\n</table></div>\n'
