"""How draws go through linear models, without a flight; `test_sensitivity` flies."""

import dataclasses
import math

import cheap
import jax.numpy as jnp
import numpy as np
import pytest
from filter_flights import aided
from pages import ROOT, assert_says, benchmark

from jentry import navigation_errors
from jentry.analysis import linear_covariance, linear_models
from jentry.analysis.covariance import LinearModel, _along_axes, _through
from jentry.analysis.linear_models import in_deviations, mean_model
from jentry.campaign import Constant, Dispersion, Normal, Uniform, add
from jentry.flight import misses
from jentry.onboard import Accelerometers


PAIRS = (
    ("mass", Dispersion(lambda s: s.vehicle.mass, Normal(2.0, 4.0), apply=add)),
    ("path", Dispersion(lambda s: s.initial_state.heading, Uniform(-0.3, 0.9))),
)


def model(time, slope, value, output_slope):
    """Of one output, x, over one dispersion, d."""
    given = {
        "time": time,
        "time_slope": {"d": slope},
        "values": {"x": value},
        "slopes": {"x": {"d": output_slope}},
    }
    names = [field.name for field in dataclasses.fields(LinearModel)]
    return LinearModel(**{name: given.get(name, {}) for name in names})


def test_a_flight_ends_by_the_condition_that_is_first_to_be_met():
    """Two ends whose times cross: by hand, in standard deviations of one dispersion."""
    models = {
        "ground": model(100.0, 2.0, 1.0, 10.0),
        "velocity": model(101.0, -1.0, 3.0, -20.0),
    }
    # 100 + 2 d and 101 - d: the second ends it where d is above 1/3.
    draws = np.array([-1.0, 0.0, 0.3, 0.4, 2.0])
    found = _through(models, {"d": draws})["x"]
    np.testing.assert_allclose(found, [-9.0, 1.0, 4.0, -5.0, -37.0], rtol=1e-14)


def test_points_lie_a_standard_deviation_from_the_mean_on_each_axis():
    deviation = 1.2 / np.sqrt(12.0)
    centre = (2.0, 0.3)
    expected = [centre, (6.0, 0.3), (-2.0, 0.3)]
    expected += [(2.0, 0.3 + deviation), (2.0, 0.3 - deviation)]
    for point, (mass, path) in zip(_along_axes(PAIRS), expected, strict=True):
        assert point["mass"] == pytest.approx(mass, rel=1e-14)
        assert point["path"] == pytest.approx(path, rel=1e-14)


def test_draws_are_counted_in_standard_deviations_from_their_mean():
    deviation = 1.2 / np.sqrt(12.0)
    draws = {"mass": np.array([6.0, -6.0]), "path": np.array([0.3, 0.3 + deviation])}
    standard = in_deviations(PAIRS, draws)
    np.testing.assert_allclose(standard["mass"], [1.0, -2.0], rtol=1e-14)
    np.testing.assert_allclose(standard["path"], [0.0, 1.0], rtol=1e-14, atol=1e-15)


def test_what_is_always_the_same_adds_nothing_to_the_spread():
    """As the noise of the accelerometers in the readings of the CAV-H mission."""
    constant = Dispersion(lambda s: s.accelerometers.noise, Constant(4.9e-4))
    draws = {"mass": np.array([6.0, -6.0]), "noise": jnp.full(2, 4.9e-4)}
    standard = in_deviations((PAIRS[0], ("noise", constant)), draws)
    np.testing.assert_allclose(standard["mass"], [1.0, -2.0], rtol=1e-14)
    np.testing.assert_array_equal(standard["noise"], [0.0, 0.0])


def test_mean_slopes_are_about_the_draws_that_end_by_the_condition(monkeypatch):
    """By hand: a line on one side of a corner, and what is not on it leaves no trace."""
    scenario = cheap.scenario()
    code = scenario.termination.names.index("velocity")

    def flown(scenario, pairs, draws, outputs, solver):
        mass, path = in_deviations(pairs, draws).values()
        ends = mass > 0.0
        x = np.where(ends, 3.0 + 5.0 * mass + 7.0 * path, 1e3 * mass)
        return {"x": x}, 100.0 + 2.0 * mass, np.where(ends, code, 1 - code), ends | True

    monkeypatch.setattr(linear_models, "fly_draws", flown)
    mass, path = np.array([0.5, -0.1, 1.5, 0.9]), np.array([-1.0, 0.2, 1.0, 0.4])
    others = {"mass": 2.0 + 4.0 * mass, "path": 0.3 + 1.2 / np.sqrt(12.0) * path}
    about = {"mass": (0.8, 0.6), "path": (0.1, 0.7)}
    model = mean_model(scenario, "velocity", PAIRS, misses, cheap.SOLVER, others, about)
    assert model is not None
    assert model.slopes["x"] == pytest.approx({"mass": 5.0, "path": 7.0}, rel=1e-12)
    assert model.errors["x"] == pytest.approx({"mass": 0.0, "path": 0.0}, abs=1e-12)
    assert model.values["x"] == pytest.approx(3.0, rel=1e-12)
    assert model.time == pytest.approx(100.0, rel=1e-12)
    assert model.time_slope == pytest.approx({"mass": 2.0, "path": 0.0}, abs=1e-12)
    # No pair of flights is on that side if the mass moves across the corner.
    across = about | {"mass": (0.0, 1.0)}
    assert not mean_model(
        scenario, "velocity", PAIRS, misses, cheap.SOLVER, others, across
    )


def test_what_only_chooses_has_no_slope(monkeypatch):
    """A seed of noise: two flights of other noise are no difference along anything."""
    sensors = Accelerometers(noise=1e-3)
    scenario = dataclasses.replace(cheap.scenario(), accelerometers=sensors)
    code = scenario.termination.names.index("velocity")
    seed = Dispersion(lambda s: s.accelerometers.noise_seed, Uniform(0.0, 1.0))
    pairs = PAIRS[0], ("noise", seed)
    assert linear_models.choosing_of(scenario, pairs) == ("noise",)
    moved = []

    def flown(scenario, pairs, draws, outputs, solver):
        mass, noise = in_deviations(pairs, draws).values()
        moved.append(mass.size)
        x = 5.0 * mass + 100.0 * noise
        return {"x": x}, 0.0 * mass, np.full(mass.size, code), mass == mass

    monkeypatch.setattr(linear_models, "fly_draws", flown)
    others = {"mass": np.zeros(4), "noise": np.array([0.1, 0.9, 0.3, 0.6])}
    about = dict.fromkeys(others, (0.0, 1.0))
    model = mean_model(scenario, "velocity", pairs, misses, cheap.SOLVER, others, about)
    assert model is not None
    assert model.slopes["x"] == pytest.approx({"mass": 5.0, "noise": 0.0}, abs=1e-12)
    assert model.errors["x"]["noise"] == 0.0
    assert moved == [8]  # no pairs of flights for the noise
    with pytest.raises(ValueError, match="constant, or choose: nothing moves"):
        mean_model(scenario, "velocity", pairs[1:], misses, cheap.SOLVER, others, about)


@pytest.mark.slow
def test_the_result_names_what_only_chooses():
    """The seed of the random walks of a navigation."""
    scenario = aided({}, 20.0)
    navigation = dataclasses.replace(scenario.navigation, filter=None)
    scenario = dataclasses.replace(scenario, navigation=navigation)
    table = {
        "up": Dispersion(lambda s: s.navigation.knowledge.up, Normal(0.0, 100.0)),
        "noise": Dispersion(lambda s: s.navigation.seed, Uniform(0.0, 1.0)),
    }
    for mode in ("exact", "difference"):
        found = linear_covariance(
            scenario, table, navigation_errors, solver=cheap.SOLVER, mode=mode
        )
        assert found.choosing == ("noise",)
        effects = found.effects["altitude"]
        assert effects["noise"].linear == 0.0
        assert effects["up"].linear == pytest.approx(100.0, rel=1e-2)
        alone = effects["up"].linear
        spread = found.spreads["altitude"].standard_deviation
        assert spread == pytest.approx(alone, rel=1e-2)  # of 100 000 draws


def navigation_tables():
    """What `benchmarks/navigation.py` has saved."""
    return benchmark("records").load(ROOT / "benchmarks" / "navigation.csv")


def test_the_page_says_how_well_navigation_is_predicted():
    """Position and velocity at the end."""
    tables = navigation_tables()

    def off(mission, size):
        """Predicted minus flown, %, by output."""
        cells = tables[f"linear, {mission}, {size}"].cells
        of_truth = [cell for cell in cells if ", true " in cell.row]
        return {c.row.split()[-1]: 100.0 * (c.value - 1.0) for c in of_truth}

    missions = "mars-range-tracking", "apollo-10"
    largest = (max(map(abs, off(m, "full size").values())) for m in missions)
    assert_says("within 4 and 5 % at full size", *map(math.ceil, largest))
    small = [off(mission, "a tenth") for mission in missions]
    crossrange = [-errors.pop("crossrange") for errors in small]
    assert_says("are predicted 19 and 5.4 % too small", *crossrange)
    others = max(abs(error) for errors in small for error in errors.values())
    assert_says("all others to within 5 %", math.ceil(others))
    headings = [tables[f"linear, {m}, full size"].cells[0].column for m in missions]
    flown = [int(heading.split()[3]) for heading in headings]
    assert flown[0] == 10_000
    assert_says("flights; 233 of", 10_000 - flown[1])


def test_the_page_says_what_the_reversals_leave_out():
    cells = navigation_tables()["reversals, apollo-10"].cells
    assert all("3000 flights with 9 to 9 reversals" in cell.row for cell in cells)
    across, along = (
        {c.column: c.value for c in cells if what in c.row}
        for what in ("crossrange", "downrange")
    )
    lines = along["left by a line, m"], across["left by a line, m"]
    assert_says("downrange to 43 m and their crossrange to 47 m", *lines)
    lines = [x["left by a line of these, m"] for x in (along, across)]
    assert_says("it fits them to 0.6 and 10 m", *lines)
    assert_says(
        "In the 186 flights that reverse", across["flights with the same reversals"]
    )
    near = 100.0 * (1.0 - across["quartiles, predicted over flown"])
    assert_says("too, are predicted 5 % too close", near)


def test_what_a_line_leaves_is_that_of_least_squares(monkeypatch):
    """Two groups of flights, each on a line of its own with noise of a known size."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    rng = np.random.default_rng(30)
    draws = rng.standard_normal((4000, 2))
    late = np.arange(4000) < 1000
    line = draws @ [30.0, -40.0]
    flown = line + np.where(late, 500.0, 0.0) + 2.0 * rng.standard_normal(4000)
    turns = np.stack([~late, late, late | True], axis=1)
    left = benchmark("navigation").left_by_a_line
    found = {c.column: c.value for c in left("x", flown, line, draws, turns)}
    assert found["flights with the same reversals"] == 3000.0
    # Five standard errors: of the noise, and of a jump of 500 in a quarter of the flights.
    assert found["left by a line of these, m"] == pytest.approx(
        2.0, rel=5.0 / np.sqrt(6000)
    )
    jump = 500.0 * np.sqrt(3.0) / 4.0
    assert found["left by a line, m"] == pytest.approx(np.hypot(jump, 2.0), rel=0.06)
    assert found["std of these, m"] == pytest.approx(50.0, rel=0.07)
    expected = 50.0 / np.sqrt(50.0**2 + jump**2 + 4.0)
    assert found["predicted over flown"] == pytest.approx(expected, rel=0.08)
