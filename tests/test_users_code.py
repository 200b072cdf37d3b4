"""A campaign knows the user's own code: with other code it is another campaign."""

import functools
import importlib
import sys

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from jentry import FixedStep
from jentry.campaign import CampaignError, Dispersion, Uniform, run_campaign
from jentry.campaign.description import describe
from jentry.campaign.users_code import own_code
from jentry.missions import ALL


LAW = """
import enum
import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import their_helpers
from jentry.guidance import AbstractContinuousLaw
from jentry.motion import Controls
from jentry.fields import Scalar, scalar

GAIN = 0.1
TABLE = np.array([1.0, 2.0])
NEAR = {"one", "two", "three"}
OTHER = 7.0


class Side(enum.Enum):
    LEFT = 0.25


class Tail:
    @functools.cached_property
    def size(self):
        return 3.25


def bank_of(drag):  # by a helper
    known = Tail().size * Side.LEFT.value * len(NEAR)
    return known * GAIN * TABLE[0] * their_helpers.shifted(drag)


class Base(AbstractContinuousLaw[None]):
    def init(self, measurement):
        return None


class Law(Base):
    start: Scalar = scalar(0.5, unit="rad")
    points: int = eqx.field(default=3, static=True)
    limit = 1.5

    def __call__(self, time, measurement, memory):
        bank = jnp.minimum(self.start + bank_of(measurement.drag), self.limit)
        return Controls.from_bank(bank, measurement.trim_angle_of_attack), None


def doubled(leaf, draw):
    return 2.0 * leaf * draw
"""

HELPERS = """
SHIFT = 1.0


def shifted(drag):
    return drag + SHIFT


def unused(drag):
    return drag
"""

CHANGES = {
    "a number": ("GAIN = 0.1", "GAIN = 0.2", "their_law.GAIN"),
    "an array": ("array([1.0, 2.0])", "array([1.0, 3.0])", "their_law.TABLE"),
    "a set": ('"one", "two"', '"one", "four"', "their_law.NEAR"),
    "a cached property": ("return 3.25", "return 3.5", "their_law.Tail.size"),
    "a member of an enumeration": (
        "LEFT = 0.25",
        "LEFT = 0.5",
        "their_law.Side.LEFT",
    ),
    "a function": ("GAIN * TABLE[0]", "GAIN / TABLE[0]", "their_law.bank_of"),
    "a constant": ("limit = 1.5", "limit = 1.6", "their_law.Law.limit"),
    "a method": ("jnp.minimum", "jnp.maximum", "their_law.Law.__call__"),
    "a base": (
        "return None\n\n\nclass Law",
        "return 2\n\n\nclass Law",
        "their_law.Base.init",
    ),
    "what it imports": ("drag + SHIFT", "drag - SHIFT", "their_helpers.shifted"),
    "its number": ("SHIFT = 1.0", "SHIFT = 2.0", "their_helpers.SHIFT"),
}
NOTHING = {
    "a comment": ("# by a helper", "# by a function"),
    "what it does not use": ("OTHER = 7.0", "OTHER = 8.0"),
    "a function that it does not use": ("    return drag\n", "    return 2 * drag\n"),
    "lines": ("\n\n\nclass Base", "\n\n\n\n\nclass Base"),
}


@pytest.fixture
def imported(tmp_path, monkeypatch):
    """Import the law of these sources, from files that are written anew."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def of(before="", after=""):
        for name, text in (("their_law", LAW), ("their_helpers", HELPERS)):
            (tmp_path / f"{name}.py").write_text(text.replace(before, after))
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        return importlib.import_module("their_law")

    yield of
    for name in ("their_law", "their_helpers"):
        sys.modules.pop(name, None)


def with_law(module, **fields):
    return eqx.tree_at(lambda s: s.guidance, cheap.scenario(), module.Law(**fields))


@pytest.mark.parametrize(("before", "after", "name"), CHANGES.values(), ids=CHANGES)
def test_what_the_law_uses_is_named_where_it_changes(imported, before, after, name):
    known = own_code(with_law(imported()))
    now = own_code(with_law(imported(before, after)))
    assert {n for n in known | now if known.get(n) != now.get(n)} == {name}


@pytest.mark.parametrize(("before", "after"), NOTHING.values(), ids=NOTHING)
def test_the_same_code_is_the_same(imported, before, after):
    assert before in LAW + HELPERS
    assert own_code(with_law(imported())) == own_code(with_law(imported(before, after)))


def test_numbers_of_the_law_are_told_elsewhere(imported):
    module = imported()
    one, other = (
        own_code(with_law(module, start=x, points=int(x))) for x in (1.0, 2.0)
    )
    assert one == other and all(len(digest) == 64 for digest in one.values())


def test_the_same_names_with_other_contents():
    """What functions are made of by others: closures, defaults, wrappers, parts of them."""

    def made(inner, given=1.0):
        def function(x, *, y=given):
            return inner * x + y

        return function

    def own(value):
        return set(own_code(value).items())

    assert own(made(1.0)) == own(made(1.0)) != own(made(2.0))
    assert own(made(1.0)) != own(made(1.0, 2.0))
    assert own(made(jnp.ones(2))) != own(made(jnp.zeros(2)))
    cached = [functools.cache(made(x)) for x in (1.0, 2.0)]
    assert own(cached[0]) != own(cached[1])
    decorated = [wrapped_otherwise(jnp.sin, factor) for factor in (1.0, 2.0)]
    assert own(decorated[0]) != own(decorated[1])
    names = {f"{__name__}.{DECORATED}", f"{__name__}.{DECORATED}.factor"}
    assert set(own_code(decorated[0])) == names
    one, other = (made(jax.random.key(seed)) for seed in (1, 2))
    assert own(one) == own(made(jax.random.key(1))) != own(other)
    assert own((lambda x: x + 1,)) != own((lambda x: x + 2,))
    assert own(eqx.Partial(made(1.0), 2.0)) != own(eqx.Partial(made(3.0), 2.0))


DECORATED = "wrapped_otherwise.<locals>.function"


def wrapped_otherwise(of_jentry, factor):
    """A function of the user's own that has the names of another."""

    @functools.wraps(of_jentry)
    def function(x):
        return factor * of_jentry(x)

    function.__qualname__ = DECORATED
    return function


def test_the_missions_have_none():
    for mission in map(ALL.get, ("mars-drag-tracking", "sx-2", "rlv")):
        assert mission is not None
        table = mission.dispersion_table().values()
        assert (
            own_code(mission.scenario(), [(x.distribution, x.apply) for x in table])
            == {}
        )
    given = mission.scenario(), mission.dispersion_table(), 0, FixedStep(), None
    assert "own_code" not in describe(*given)


def test_a_campaign_of_changed_code_is_not_resumed(imported, tmp_path):
    def fly(module, runs, apply):
        mass = Dispersion(lambda s: s.vehicle.mass, Uniform(0.45, 0.55), apply=apply)
        given = with_law(module), {"mass": mass}, 0, runs
        run_campaign(tmp_path / "campaign", *given, solver=cheap.SOLVER)

    module = imported()
    fly(module, 2, module.doubled)
    module = imported("# by a helper", "")
    fly(module, 3, module.doubled)
    for before, after, name in (
        ("GAIN * TABLE[0]", "GAIN / TABLE[0]", "their_law.bank_of"),
        ("2.0 * leaf", "2.01 * leaf", "their_law.doubled"),
    ):
        module = imported(before, after)
        with pytest.raises(CampaignError, match=f"own_code.{name} differs"):
            fly(module, 4, module.doubled)
