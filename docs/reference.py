"""The reference: a page for each topic, with all that is public there."""

import importlib
import inspect
from pathlib import Path

import jentry


TOPICS = {
    "world": "Planet and vehicle",
    "motion": "State and motion",
    "onboard": "Onboard models",
    "guidance": "Guidance laws",
    "flight": "Flights",
    "campaign": "Campaigns",
    "kernel": "Kernels",
    "statistics": "Statistics",
    "planning": "Planning and best flights",
    "tuning": "Tuning",
    "analysis": "Linear analysis",
    "learning": "Networks",
    "missions": "Missions",
    "plots": "Figures",
    "fields": "Fields of a scenario",
    "units": "Units",
}
"""Titles of the pages, by package"""


def write_reference(folder: Path) -> list[dict[str, str]]:
    """Write the pages; return their entries of the navigation.

    Raises `ValueError` for a public name that is on no page.
    """
    folder.mkdir(parents=True)
    shown: set[str] = set()
    entries = []
    for package, title in TOPICS.items():
        module = importlib.import_module(f"jentry.{package}")
        names = public_names(module)
        lines = [f"# {title}", ""]
        for name in names:
            at_top = getattr(jentry, name, None) is getattr(module, name)
            path = f"jentry.{name}" if at_top else f"jentry.{package}.{name}"
            shown.add(name)
            lines += [f"::: {path}", ""]
        (folder / f"{package}.md").write_text("\n".join(lines), encoding="utf-8")
        entries.append({title: f"reference/{package}.md"})
    lines = ["# Setup and errors", ""]
    for name in sorted(set(jentry.__all__) - shown):
        lines += [f"::: jentry.{name}", ""]
    (folder / "setup.md").write_text("\n".join(lines), encoding="utf-8")
    return [*entries, {"Setup and errors": "reference/setup.md"}]


def public_names(module) -> list[str]:
    """What a package offers, in the order in which it imports it.

    A module that is not a package offers what the top of jentry has of it.
    """
    if not hasattr(module, "__path__"):
        return [x for x in jentry.__all__ if vars(jentry)[x] is vars(module).get(x)]
    return [
        name
        for name, thing in vars(module).items()
        if not name.startswith("_")
        and not inspect.ismodule(thing)
        and getattr(thing, "__module__", "jentry").startswith("jentry")
    ]
