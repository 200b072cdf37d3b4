"""Random bits of the generator Threefry-2x32, from additions, rotations and exclusive ors.

A key is two words of 32 bits. The bits are those of `jax.random` with its default
generator.

Reference: Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3",
SC11, 2011, section 4.
"""

from typing import Any

import numpy as np


_ROTATIONS = (13, 15, 26, 6), (17, 29, 16, 24)
_PARITY = np.uint32(0x1BD11BDA)


def threefry(operations: Any, key: tuple[Any, Any], counter: tuple[Any, Any]):
    """Two words from a key and a counter of two words each.

    `operations` has the methods `add`, `xor`, `left` and `right`; the last two shift by a
    known number of bits.
    """
    add, xor = operations.add, operations.xor
    schedule = key[0], key[1], xor(xor(key[0], key[1]), _PARITY)
    x, y = add(counter[0], schedule[0]), add(counter[1], schedule[1])
    for group in range(5):
        for bits in _ROTATIONS[group % 2]:
            x = add(x, y)
            turned = operations.left(y, bits), operations.right(y, 32 - bits)
            y = xor(x, xor(*turned))
        x = add(x, schedule[(group + 1) % 3])
        y = add(add(y, schedule[(group + 2) % 3]), np.uint32(group + 1))
    return x, y
