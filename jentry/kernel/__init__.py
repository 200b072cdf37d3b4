"""Floor 1: a traced function of one flight as a kernel for a GPU."""

from .elements import NotInKernel as NotInKernel
from .kernel import Form as Form, kernel_of as kernel_of
from .tangents import with_tangents as with_tangents
