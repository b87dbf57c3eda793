"""The processor's features that Numba may use; MINIMD_VECTORS leaves out those of newer vectors, to compare or test."""

import llvmlite.binding as llvm
import numba

NEWEST = "avx512"
WIDER = {  # beginnings of names of the features that each choice does without
    NEWEST: (),
    "avx2": ("avx512", "avx10"),
    "sse": ("avx", "fma", "f16c", "vaes", "vpclmulqdq", "xop"),
}


def restrict_features(choice: str) -> None:
    """Let Numba compile for the vectors of an older processor, avx512, avx2 or sse; only before anything is compiled.
    Raises ValueError for another word."""
    if choice not in WIDER:
        raise ValueError(f"MINIMD_VECTORS must be one of {', '.join(WIDER)}; it is {choice!r}")
    if WIDER[choice]:
        has = llvm.get_host_cpu_features()
        signs = ("-" if name.startswith(WIDER[choice]) or not has[name] else "+" for name in has)
        wanted = ",".join(sign + name for sign, name in zip(signs, has, strict=True))
        numba.config.CPU_FEATURES = wanted  # type: ignore[attr-defined]
