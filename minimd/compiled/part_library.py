"""How Numba compiles what only kernels call: neither to its end nor to machine code, since the kernel around it is."""

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class PartLibrary(JITCodeLibrary):
    """The code of a part of a kernel, for the library of the kernel to link. Nobody can call it.
    Numba would optimize each part as a whole, and again as a part of what calls it, and so on up to the kernel."""

    def _optimize_final_module(self) -> None:
        """Left to the kernel."""

    def _finalize_final_module(self) -> None:
        """Without machine code."""
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """None."""
        return 0

    @property
    def codegen(self) -> Any:
        """For the executable that Numba makes of any function: this one needs nothing."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """There is no machine code that could read it."""


class PartCompiler(Compiler):
    """Numba's compiler, for parts of kernels."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *arguments: Any) -> None:
        super().__init__(typingctx, targetctx, library or PartLibrary(targetctx.codegen(), "part"), *arguments)
