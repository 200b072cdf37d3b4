"""The US Standard Atmosphere 1976, from below sea level to 1000 km and beyond.

Every number of this file is from the standard: US Standard Atmosphere, 1976,
NOAA-S/T 76-1562 (NASA-TM-X-74335), October 1976. Tables and equations have the numbers of
the standard.
"""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._interpolation import clamp
from .._math import horner
from ..fields import Scalar
from .atmosphere import AbstractAtmosphere


_GAS_CONSTANT = 8314.32
"""Gas constant of the standard, J/(kmol K), Table 2; today's value differs"""
_MOLECULAR_WEIGHT = 28.9644
"""Molecular weight of air up to 80 km, kg/kmol"""
_GRAVITY = 9.80665
"""Acceleration of gravity at sea level, m/s2"""
_EARTH_RADIUS = 6356766.0
"""Radius with which geopotential altitude follows from geometric altitude, m"""
_HEAT_CAPACITY_RATIO = 1.4
_SEA_LEVEL_PRESSURE = 101325.0
_SEA_LEVEL_TEMPERATURE = 288.15

_AIR = _GAS_CONSTANT / _MOLECULAR_WEIGHT
"""Specific gas constant of air, J/(kg K)"""

_LOWEST = -100_000.0
"""Altitude down to which the troposphere continues, m; below it the air is constant"""
_JOIN = 86_000.0
"""Altitude between the hydrostatic layers and the number densities of the species, m"""
_HIGHEST = 1_000_000.0
"""Upper end of the standard, m; the density continues with its last scale height"""

# Base of each layer (geopotential m) and gradient of the molecular temperature (K/m):
# Table 4.
_LAYERS = (
    (0.0, -0.0065),
    (11_000.0, 0.0),
    (20_000.0, 0.0010),
    (32_000.0, 0.0028),
    (47_000.0, 0.0),
    (51_000.0, -0.0028),
    (71_000.0, -0.0020),
)

# Molecular weight over its value at sea level, each 500 m from 80 to 86 km: Table 8.
_WEIGHT_RATIO_ALTITUDES = np.linspace(80_000.0, 86_000.0, 13)
_WEIGHT_RATIOS = np.array(
    [
        *(1.0, 0.999996, 0.999989, 0.999971, 0.999941, 0.999909, 0.999870),
        *(0.999829, 0.999786, 0.999741, 0.999694, 0.999641, 0.999579),
    ]
)

# Temperature above 86 km: 186.8673 K to 91 km, an ellipse to 110 km, 12 K/km to 120 km
# and an exponential approach to 1000 K (equations 25, 27, 29 and 31). Centre and axes
# of the ellipse follow from the temperatures at its ends and the gradient at the upper
# end. The standard prints them rounded, which would leave a step of 3e-4 K.
_ISOTHERMAL = 186.8673
_ELLIPSE_START, _ELLIPSE_END, _LINEAR_END = 91.0, 110.0, 120.0
_ELLIPSE_END_TEMPERATURE, _GRADIENT = 240.0, 12.0
_LINEAR_END_TEMPERATURE, _EXOSPHERE = 360.0, 1000.0
_RISE = _ELLIPSE_END_TEMPERATURE - _ISOTHERMAL
_SPAN = _ELLIPSE_END - _ELLIPSE_START
_COSINE = _RISE / (_GRADIENT * _SPAN - _RISE)
_HALF_AXIS = _RISE / (1.0 - _COSINE)
_HALF_WIDTH = _SPAN / math.sqrt(1.0 - _COSINE**2)

# Altitude (km), density (kg/m3), density scale height (km), molecular weight (kg/kmol):
# the standard's equations for the number densities of six gases, integrated in steps of
# 5 m (`tests/test_atmosphere.py` repeats this). The densities agree with the four digits
# that the standard prints in Table I to one unit of the last digit.
_UPPER = (
    (86, 6.957880e-06, 5.6196, 28.9522),
    (87, 5.823915e-06, 5.6223, 28.9471),
    (88, 4.875098e-06, 5.624, 28.9393),
    (89, 4.081017e-06, 5.6248, 28.9275),
    (90, 3.416307e-06, 5.6245, 28.9108),
    (91, 2.859779e-06, 5.6228, 28.8883),
    (92, 2.392566e-06, 5.59, 28.8594),
    (93, 1.999706e-06, 5.561, 28.824),
    (94, 1.669889e-06, 5.5357, 28.7825),
    (95, 1.393406e-06, 5.5144, 28.7349),
    (96, 1.161970e-06, 5.4977, 28.6814),
    (97, 9.685296e-07, 5.4868, 28.6214),
    (98, 8.070847e-07, 5.4819, 28.5538),
    (99, 6.724978e-07, 5.4821, 28.4783),
    (100, 5.604053e-07, 5.5269, 28.3953),
    (101, 4.695273e-07, 5.6567, 28.3048),
    (102, 3.935220e-07, 5.6699, 28.2078),
    (103, 3.299805e-07, 5.6879, 28.1049),
    (104, 2.768713e-07, 5.71, 27.9965),
    (105, 2.324775e-07, 5.7346, 27.8832),
    (106, 1.953480e-07, 5.7585, 27.7657),
    (107, 1.642528e-07, 5.7751, 27.6445),
    (108, 1.381382e-07, 5.7698, 27.5205),
    (109, 1.160688e-07, 5.7035, 27.3945),
    (110, 9.707482e-08, 5.425, 27.2679),
    (111, 8.111098e-08, 5.711, 27.1426),
    (112, 6.837550e-08, 6.0012, 27.02),
    (113, 5.810851e-08, 6.2938, 26.9014),
    (114, 4.975085e-08, 6.5882, 26.7878),
    (115, 4.288608e-08, 6.8839, 26.6795),
    (116, 3.720061e-08, 7.1809, 26.5761),
    (117, 3.245570e-08, 7.4788, 26.4774),
    (118, 2.846757e-08, 7.7776, 26.3829),
    (119, 2.509337e-08, 8.0771, 26.292),
    (120, 2.222104e-08, 8.3771, 26.2045),
    (125, 1.290767e-08, 10.075, 25.8029),
    (130, 8.152146e-09, 11.718, 25.4359),
    (135, 5.464981e-09, 13.313, 25.0866),
    (140, 3.831167e-09, 14.862, 24.7493),
    (145, 2.780941e-09, 16.368, 24.4218),
    (150, 2.075597e-09, 17.839, 24.1028),
    (155, 1.584797e-09, 19.247, 23.7918),
    (160, 1.233168e-09, 20.623, 23.4881),
    (165, 9.750103e-10, 21.957, 23.1915),
    (170, 7.815004e-10, 23.25, 22.9017),
    (175, 6.338390e-10, 24.505, 22.6186),
    (180, 5.194059e-10, 25.722, 22.3422),
    (185, 4.295144e-10, 26.904, 22.0725),
    (190, 3.580525e-10, 28.051, 21.8094),
    (195, 3.006357e-10, 29.166, 21.5531),
    (200, 2.540638e-10, 30.249, 21.3037),
    (225, 1.183883e-10, 35.246, 20.16),
    (250, 6.072486e-11, 39.642, 19.1899),
    (275, 3.329090e-11, 43.522, 18.3849),
    (300, 1.915729e-11, 46.925, 17.7256),
    (325, 1.143184e-11, 49.879, 17.1857),
    (350, 7.013455e-12, 52.415, 16.7353),
    (375, 4.396118e-12, 54.584, 16.3443),
    (400, 2.802610e-12, 56.45, 15.9839),
    (425, 1.811398e-12, 58.086, 15.6266),
    (450, 1.184318e-12, 59.567, 15.247),
    (475, 7.822109e-13, 60.972, 14.8217),
    (500, 5.215151e-13, 62.379, 14.3301),
    (525, 3.509365e-13, 63.868, 13.7564),
    (550, 2.384262e-13, 65.526, 13.0917),
    (575, 1.636752e-13, 67.453, 12.3371),
    (600, 1.136657e-13, 69.762, 11.5055),
    (625, 7.997608e-14, 72.588, 10.6213),
    (650, 5.711562e-14, 76.088, 9.71792),
    (675, 4.148116e-14, 80.44, 8.83225),
    (700, 3.069466e-14, 85.84, 7.99828),
    (725, 2.317856e-14, 92.491, 7.24203),
    (750, 1.788136e-14, 100.58, 6.57887),
    (775, 1.409904e-14, 110.23, 6.01378),
    (800, 1.135807e-14, 121.51, 5.5434),
    (825, 9.338519e-15, 134.34, 5.15894),
    (850, 7.823199e-15, 148.49, 4.84889),
    (875, 6.663909e-15, 163.62, 4.60105),
    (900, 5.758961e-15, 179.24, 4.40385),
    (925, 5.038140e-15, 194.84, 4.24707),
    (950, 4.452620e-15, 209.94, 4.12203),
    (975, 3.968173e-15, 224.12, 4.02163),
    (1000, 3.560585e-15, 237.13, 3.94014),
)


def _layer_table() -> np.ndarray:
    """Base, temperature and log density at it, gradient, power and rate of each layer.

    With the temperature T and the geopotential altitude h above the base,
    log density = log density at the base - power * log(T / T at the base) - rate * h.
    The power is that of layers with a gradient, the rate that of layers without one
    (equations 33a and 33b).
    """
    tops = [base for base, _ in _LAYERS[1:]] + [math.inf]
    temperature = _SEA_LEVEL_TEMPERATURE
    log_density = math.log(_SEA_LEVEL_PRESSURE / (_AIR * temperature))
    rows = []
    for (base, gradient), top in zip(_LAYERS, tops, strict=True):
        if gradient:
            power, rate = 1.0 + _GRAVITY / (_AIR * gradient), 0.0
        else:
            power, rate = 0.0, _GRAVITY / (_AIR * temperature)
        rows.append((base, temperature, log_density, gradient, power, rate))
        if top < math.inf:
            top_temperature = temperature + gradient * (top - base)
            log_density -= power * math.log(top_temperature / temperature)
            log_density -= rate * (top - base)
            temperature = top_temperature
    return np.array(rows)


_LAYER_TABLE = _layer_table()


def _cubics(x, values, slopes) -> np.ndarray:
    """Coefficients of the cubic on each interval in a variable from 0 to 1, highest power
    first."""
    width = np.diff(x)
    rise = np.diff(values)
    start, end = width * slopes[:-1], width * slopes[1:]
    return np.stack(
        [start + end - 2.0 * rise, 3.0 * rise - 2.0 * start - end, start, values[:-1]],
        axis=-1,
    )


def _upper_tables() -> tuple[np.ndarray, np.ndarray]:
    """Cubics for log density and for molecular weight on the intervals of `_UPPER`.

    The first node has the values of the layers at 86 km, so that density and pressure are
    continuous. They differ by 8e-6 from those that the standard prints.
    """
    x, density, scale_height, weight = np.array(_UPPER).T
    base, base_temperature, log_density, gradient, power, _ = _LAYER_TABLE[-1]
    geopotential = _EARTH_RADIUS * _JOIN / (_EARTH_RADIUS + _JOIN)
    temperature = base_temperature + gradient * (geopotential - base)
    log_densities = np.log(density)
    log_densities[0] = log_density - power * math.log(temperature / base_temperature)
    weight[0] = _MOLECULAR_WEIGHT * _ISOTHERMAL / temperature
    return (
        _cubics(x, log_densities, -1.0 / scale_height),
        _cubics(x, weight, np.gradient(weight, x)),
    )


_LOG_DENSITY, _WEIGHT = _upper_tables()
_LAST_SCALE_HEIGHT = 1000.0 * _UPPER[-1][2]


class USStandardAtmosphere1976(AbstractAtmosphere):
    """The US Standard Atmosphere 1976 over geometric altitude.

    Up to 86 km it has the exact formulas of the seven layers of the standard. Above, it has
    the standard's closed form of the temperature, and cubics through tables of density and
    mean molecular weight. The tables come from the standard's equations for the number
    densities of the species. The cubics are within 1e-4 of an integration of these
    equations, and within 6e-4 near 100 km, where the standard's scale height has a step.

    It extends beyond the range of the standard: with the gradient of the troposphere below
    -5 km, and with the last scale height and molecular weight above 1000 km. The standard
    defines no speed of sound above 86 km. Here it is sqrt(1.4 R T / M) with the molecular
    weight at that altitude, so that a Mach number exists everywhere.

    It has no numbers to disperse: disperse `Planet.density_scale` instead.

    Reference: US Standard Atmosphere, 1976, NOAA-S/T 76-1562, Washington, 1976.
    """

    def density(self, altitude: Scalar) -> Scalar:
        log_density = jnp.where(
            altitude < _JOIN, _lower_log_density(altitude), _upper_log_density(altitude)
        )
        return jnp.exp(log_density)

    def temperature(self, altitude: Scalar) -> Scalar:
        """Kinetic temperature, K."""
        ratio = jnp.interp(
            altitude, jnp.asarray(_WEIGHT_RATIO_ALTITUDES), jnp.asarray(_WEIGHT_RATIOS)
        )
        return jnp.where(
            altitude < _JOIN,
            ratio * _lower_molecular_temperature(altitude),
            _upper_temperature(altitude),
        )

    def pressure(self, altitude: Scalar) -> Scalar:
        return self.density(altitude) * _AIR * _molecular_temperature(altitude)

    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        return jnp.sqrt(_HEAT_CAPACITY_RATIO * _AIR * _molecular_temperature(altitude))


def _molecular_temperature(altitude: Scalar) -> Scalar:
    """Molecular-scale temperature, K: that of sea-level air with an equal p / rho."""
    weight = horner(*_upper_cubic(_WEIGHT, altitude))
    upper = _upper_temperature(altitude) * _MOLECULAR_WEIGHT / weight
    lower = _lower_molecular_temperature(altitude)
    return jnp.where(altitude < _JOIN, lower, upper)


def _layer(altitude: Scalar) -> tuple[Scalar, Float[Array, "6"]]:
    """Geopotential altitude above the base of the layer, and the layer's numbers."""
    altitude = clamp(altitude, _LOWEST, _JOIN)
    geopotential = _EARTH_RADIUS * altitude / (_EARTH_RADIUS + altitude)
    number = sum(jnp.asarray(geopotential >= base, int) for base, _ in _LAYERS[1:])
    layer = jnp.asarray(_LAYER_TABLE)[number]
    return geopotential - layer[0], layer


def _lower_molecular_temperature(altitude: Scalar) -> Scalar:
    height, (_, base_temperature, _, gradient, *_) = _layer(altitude)
    return base_temperature + gradient * height


def _lower_log_density(altitude: Scalar) -> Scalar:
    height, (_, base_temperature, log_density, gradient, power, rate) = _layer(altitude)
    warming = jnp.log(1.0 + gradient * height / base_temperature)
    return log_density - power * warming - rate * height


def _upper_cubic(
    cubics: np.ndarray, altitude: Scalar
) -> tuple[Float[Array, "4"], Scalar]:
    """The cubic of the interval of an altitude, and its variable there."""
    km = 1e-3 * clamp(altitude, _JOIN, _HIGHEST)
    position = jnp.where(
        km < 120.0,
        km - 86.0,
        jnp.where(km < 200.0, 34.0 + (km - 120.0) / 5.0, 50.0 + (km - 200.0) / 25.0),
    )
    number = jnp.clip(position.astype(int), 0, len(cubics) - 1)
    return jnp.asarray(cubics)[number], position - number


def _upper_log_density(altitude: Scalar) -> Scalar:
    beyond = altitude - clamp(altitude, _JOIN, _HIGHEST)
    return horner(*_upper_cubic(_LOG_DENSITY, altitude)) - beyond / _LAST_SCALE_HEIGHT


def _upper_temperature(altitude: Scalar) -> Scalar:
    km = 1e-3 * clamp(altitude, _LOWEST, jnp.inf)
    x = (clamp(km, _ELLIPSE_START, _ELLIPSE_END) - _ELLIPSE_START) / _HALF_WIDTH
    ellipse = _ISOTHERMAL + _HALF_AXIS * (1.0 - jnp.sqrt(1.0 - x * x))
    linear = _ELLIPSE_END_TEMPERATURE + _GRADIENT * (km - _ELLIPSE_END)
    radius = 1e-3 * _EARTH_RADIUS
    height = (km - _LINEAR_END) * (radius + _LINEAR_END) / (radius + km)
    excess = _EXOSPHERE - _LINEAR_END_TEMPERATURE
    exponential = _EXOSPHERE - excess * jnp.exp(-_GRADIENT / excess * height)
    return jnp.where(
        km < _ELLIPSE_END, ellipse, jnp.where(km < _LINEAR_END, linear, exponential)
    )
