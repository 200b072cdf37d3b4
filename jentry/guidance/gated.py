"""A law that starts at a sensed drag, with another law before."""

from typing import TypeVar

import jax
import jax.numpy as jnp

from ..fields import Scalar, scalar
from ..motion.state import Controls
from ..onboard.measurement import Measurement
from .law import AbstractContinuousLaw, Tracked


Memory = TypeVar("Memory")


class Gated(AbstractContinuousLaw[Memory]):
    """A continuous law above a sensed drag; below it another law, without memory.

    The memory of the law is constant while the drag is below. `Gated` is for laws that have
    no gate, such as those over the energy, which hardly falls before there is drag. The
    sensed drag selects the command: with an ideal attitude response the command must be
    held, `Sampled(Gated(...), period)`.
    """

    law: AbstractContinuousLaw[Memory]
    before: AbstractContinuousLaw[None]
    drag: Scalar = scalar(unit="m/s2", positive=True)

    def init(self, measurement: Measurement) -> Memory:
        return self.law.init(measurement)

    def tracked(
        self, time: Scalar, measurement: Measurement, held: None
    ) -> Tracked | None:
        return self.law.tracked(time, measurement, held)

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Memory
    ) -> tuple[Controls, Memory]:
        begun = measurement.drag > self.drag
        until, _ = self.before(time, measurement, None)
        controls, rate = self.law(time, measurement, memory)
        chosen = jax.tree.map(lambda a, b: jnp.where(begun, a, b), controls, until)
        return chosen, jax.tree.map(lambda x: jnp.where(begun, x, 0.0), rate)
