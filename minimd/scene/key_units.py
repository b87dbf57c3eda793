"""Units that a key of a scene file may end in."""

from minimd.structure.units import BOLTZMANN_EV_PER_K, DEGREE, FEMTOSECOND, GRAM_PER_CM3

KEY_UNITS: dict[str, dict[str, dict[str, float]]] = {  # unit system: dimension: ending of the key: size of that unit
    "ASE": {
        "length": {"_A": 1.0},
        "time": {"_fs": FEMTOSECOND},
        "temperature": {"_K": 1.0},
        "energy": {"_K": BOLTZMANN_EV_PER_K, "_eV": 1.0},
        "force": {"_eV_A": 1.0},
        "density": {"_g_cm3": GRAM_PER_CM3},
        "stiffness": {"_eV_A2": 1.0},
        "angle": {"_degree": DEGREE},
        "angular stiffness": {"_eV_rad2": 1.0},
    },
    "LJ": {
        **{dimension: {"": 1.0} for dimension in ("length", "time", "temperature", "energy", "force", "density", "stiffness", "angular stiffness")},
        "angle": {"_degree": DEGREE},
    },
}
