"""Flights as kernels: a whole flight in one program of a GPU."""

from .elements import NotInKernel
from .kernel import BLOCK, Form, kernel_of
from .tangents import with_tangents


__all__ = "BLOCK", "Form", "NotInKernel", "kernel_of", "with_tangents"
