"""A law that is trained from several seeds, of which the best is taken."""

import equinox as eqx
import numpy as np
import pytest
from neural_laws import SOLVER
from test_law_training import training_of
from test_neural_training import FLIGHTS, Stopped

import jentry.learning.law_seeds as law_seeds
from jentry.campaign.campaign import drawn_inputs
from jentry.learning import AdamSteps, robust_mean, train_law, train_law_of_seeds
from jentry.learning.flight_residuals import flown, ground_miss
from jentry.learning.law_seeds import best_seed
from jentry.learning.training_record import HeldOut
from jentry.onboard import load_recurrent_network
from jentry.tuning.batch_gradients import Simulation


FEW = (AdamSteps(robust_mean, steps=2, flights=FLIGHTS, rate=3e-2),)

SEEDS = [5, 3]


def test_the_best_seed_loses_the_fewest_flights_and_then_is_nearest():
    near, safe = HeldOut((1.0, 2.0, 3.0, 9.0), 0), HeldOut((2.0, 3.0, 4.0, 5.0), 0)
    lost = HeldOut((0.1, 0.1, 0.1, 0.1), 1)
    every = {4: lost, 9: near, 2: safe, 7: near}
    assert [best_seed(every, p) for p in (50.0, 95.0, 99.0, 99.9)] == [9, 9, 9, 2]
    assert best_seed({4: lost}, 99.0) == 4


@pytest.mark.parametrize("seeds", [[], [3, 5, 3]])
def test_seeds_are_given_and_each_once(tmp_path, seeds):
    with pytest.raises(ValueError, match="give at least one seed, and each once"):
        train_law_of_seeds(training_of(FEW), seeds, tmp_path)


@pytest.mark.slow
def test_an_ensemble_needs_flights_that_choose(tmp_path):
    with pytest.raises(ValueError, match="held_out is 0"):
        train_law_of_seeds(training_of(FEW), SEEDS, tmp_path, held_out=0)


def trained(folder, **options):
    training = training_of(FEW, judged_by=50.0)
    return train_law_of_seeds(training, SEEDS, folder, held_out=FLIGHTS, **options)


@pytest.fixture(scope="module")
def ensemble(tmp_path_factory):
    """The ensemble, its folder, and the draws of the flights that judged its laws."""
    drawn, folder = [], tmp_path_factory.mktemp("ensemble")

    def remember(*given):
        found = drawn_inputs(*given)
        drawn.append(found)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(law_seeds, "drawn_inputs", remember)
        found = trained(folder, card={"mission": "a test"})
    return found, folder, drawn


@pytest.mark.slow
def test_each_seed_is_trained_as_alone(ensemble, tmp_path):
    found, folder, _ = ensemble
    assert list(found.laws) == SEEDS
    for seed in SEEDS:
        alone = train_law(training_of(FEW, judged_by=50.0), seed, tmp_path / str(seed))
        law = found.laws[seed].scenario.guidance
        assert eqx.tree_equal(law, alone.scenario.guidance)
        stored, card = load_recurrent_network(folder / f"seed-{seed}" / "law.npz")
        assert eqx.tree_equal(stored, law.network) and card["seed"] == seed


@pytest.mark.slow
def test_the_best_is_chosen_and_judged_on_flights_of_their_own(ensemble):
    """All seeds fly the same flights, and the best flies others."""
    found, _, drawn = ensemble
    density = [draws["planet.density_scale"] for draws in drawn]
    np.testing.assert_array_equal(density[0], density[1])
    assert not set(density[2]) & set(density[0])
    for law in found.laws.values():
        assert law.final.distances not in [x.distances for x in found.choosing.values()]
    simulation = Simulation(ground_miss, SOLVER)
    for seed, draws in zip([*SEEDS, found.best], drawn, strict=True):
        residuals, finite = flown(found.laws[seed].scenario, simulation, draws)
        assert np.all(finite)
        expected = np.median(np.hypot(*residuals.T))
        judged = found.final if draws is drawn[2] else found.choosing[seed]
        assert judged.distances[0] == pytest.approx(expected, rel=1e-12)
        assert judged.without_end == 0
    medians = {seed: x.distances[0] for seed, x in found.choosing.items()}
    assert medians[found.best] == min(medians.values()) < max(medians.values())
    assert found.scenario is found.laws[found.best].scenario


@pytest.mark.slow
def test_the_folder_has_the_best_network_and_its_card_all_seeds(ensemble):
    found, folder, _ = ensemble
    network, card = load_recurrent_network(folder / "law.npz")
    assert eqx.tree_equal(network, found.scenario.guidance.network)
    assert card["seed"] == found.best and card["mission"] == "a test"
    assert set(card["chosen from seeds"]) == {"5", "3"}
    for seed, judged in found.choosing.items():
        shown = card["chosen from seeds"][str(seed)]
        assert tuple(shown.values()) == judged.distances
    assert tuple(card["held out distance"].values()) == found.final.distances
    assert card["chosen by"] == "50 %"


@pytest.mark.slow
def test_an_ensemble_resumes_bit_for_bit(ensemble, tmp_path):
    """Stopped within the second seed."""
    found, *_ = ensemble
    seen = []

    def stop(training, judged):
        seen.append(judged)
        if len(seen) == 3:
            raise Stopped

    with pytest.raises(Stopped):
        trained(tmp_path, report=stop)
    again = trained(tmp_path)
    assert (again.best, again.choosing, again.final) == (
        found.best,
        found.choosing,
        found.final,
    )
    assert eqx.tree_equal(again.scenario.guidance, found.scenario.guidance)
