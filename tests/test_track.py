"""Coordinates about a great circle: the same flight anywhere on the globe."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ahead

from jentry.motion import EntryState
from jentry.onboard import Track
from jentry.units import degree, km


MERIDIAN = Track(0.0, 0.0, 0.0, 55.9067 * degree)


def at(longitude, latitude, heading):
    """A state; angles in degrees."""
    angles = (jnp.asarray(a * degree) for a in (longitude, latitude, heading))
    longitude, latitude, heading = angles
    return EntryState(50 * km, longitude, latitude, 7500.0, 0.0, heading)


def test_on_a_meridian_they_are_latitude_and_longitude():
    place = MERIDIAN.position(at(0.7, 21.0, 4.0))
    assert float(place.along) == pytest.approx(21.0 * degree, abs=1e-15)
    assert float(place.cross) == pytest.approx(0.7 * degree, abs=1e-15)
    assert float(place.cos_heading) == pytest.approx(np.cos(4.0 * degree), abs=1e-15)
    assert float(place.sin_heading) == pytest.approx(np.sin(4.0 * degree), abs=1e-15)
    assert float(MERIDIAN.length()) == pytest.approx(55.9067 * degree, abs=1e-15)


TRACKS = {
    "north-east": ((20.0, 35.0), 60.0, 50.0),
    "over the pole": ((-100.0, 60.0), 10.0, 55.0),
    "across the date line": ((170.0, -20.0), 100.0, 40.0),
    "long": ((10.0, -50.0), -30.0, 150.0),
}


@pytest.mark.parametrize(("start", "heading", "length"), TRACKS.values(), ids=TRACKS)
def test_along_any_great_circle(start, heading, length):
    """Evenly along, nothing across, and straight ahead, wherever it lies."""
    longitude, latitude, _ = ahead(start, heading, length)
    angles = (*start, longitude, latitude)
    track = Track(*(a * degree for a in angles))
    assert float(track.length()) == pytest.approx(length * degree, abs=1e-14)
    begin = track.position(at(*start, heading))
    for share in (0.0, 0.3, 0.77, 1.0):
        place = track.position(at(*ahead(start, heading, share * length)))
        moved = float(place.along - begin.along)
        # Rounding of the textbook formulas, in float64.
        assert moved == pytest.approx(share * length * degree, abs=1e-13)
        assert float(place.cross) == pytest.approx(0.0, abs=1e-13)
        assert float(place.sin_heading) == pytest.approx(0.0, abs=1e-13)
        assert float(place.cos_heading) == pytest.approx(1.0, abs=1e-13)


@pytest.mark.parametrize(("start", "heading", "length"), TRACKS.values(), ids=TRACKS)
def test_to_the_right_is_positive(start, heading, length):
    longitude, latitude, _ = ahead(start, heading, length)
    track = Track(*(a * degree for a in (*start, longitude, latitude)))
    on_track = ahead(start, heading, 0.4 * length)
    right = ahead(on_track[:2], on_track[2] + 90.0, 0.5)
    place = track.position(at(right[0], right[1], right[2] - 90.0))
    assert float(place.cross) > 0.008
    assert float(track.position(at(*on_track[:2], on_track[2] + 5)).sin_heading) == (
        pytest.approx(np.sin(5 * degree), abs=1e-13)
    )


def test_way_to_go_is_zero_in_the_plane_of_the_target():
    track = Track(*(a * degree for a in (20.0, 35.0, *ahead((20.0, 35.0), 60, 50)[:2])))
    end = ahead((20.0, 35.0), 60.0, 50.0)
    aside = ahead(end[:2], end[2] + 90.0, 3.0)
    assert float(track.to_go(at(*aside))) == pytest.approx(0.0, abs=1e-14)
    before = ahead((20.0, 35.0), 60.0, 49.0)
    assert float(track.to_go(at(*before))) == pytest.approx(np.sin(degree), abs=1e-14)
    beyond = ahead((20.0, 35.0), 60.0, 51.0)
    assert float(track.to_go(at(*beyond))) < 0.0


def test_derivatives_are_those_of_differences():
    state = at(0.7, 21.0, 4.0)

    def along_and_cross(longitude, latitude):
        place = MERIDIAN.position(
            EntryState(50 * km, longitude, latitude, 7500.0, 0.0, state.heading)
        )
        return jnp.stack([jnp.asarray(place.along), jnp.asarray(place.cross)])

    slopes = jax.jacrev(along_and_cross, argnums=(0, 1))(
        state.longitude, state.latitude
    )
    # On a meridian each coordinate is one of the two.
    np.testing.assert_allclose(np.stack(slopes), [[0.0, 1.0], [1.0, 0.0]], atol=1e-14)


@pytest.mark.parametrize("latitude", [0.0, 170.0])
def test_a_track_needs_a_length(latitude):
    with pytest.raises(ValueError, match="deg long: start and target must be apart"):
        Track(0.0, 0.0, 0.0, latitude * degree)
