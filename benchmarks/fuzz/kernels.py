"""Every kernel of the core, as the modules that call it declare it."""

import importlib
from pathlib import Path

import trigpoint
from trigpoint.native.library import Handle, Kernel

_PARTS = ("edge", "fusion")
# The core's objects, and the kernels that take one, in the order in which they make sense.
OBJECTS = {
    "tp_curvature": ("tp_saddles", "tp_grids", "tp_grown"),
    "tp_quad_search": ("tp_quads",),
    "tp_equations": (
        *("tp_minimised", "tp_visit_round", "tp_visit_linear"),
        *("tp_reduced", "tp_full_system"),
    ),
    "tp_factor": ("tp_graph_minimum", "tp_factor_covariance", "tp_agreement"),
    "tp_rest": ("tp_rest_added", "tp_odometry_added", "tp_rest_saved", "tp_rest_restored"),
    "tp_pattern": ("tp_pattern_set", "tp_pattern_print", "tp_measured"),
}


def all_kernels() -> tuple[Kernel, ...]:
    """Of all modules of edge and fusion, by name."""
    found: dict[str, Kernel] = {}
    house = Path(trigpoint.__path__[0])
    for file in (file for part in _PARTS for file in (house / part).rglob("*.py")):
        if " = Kernel(" not in file.read_text():
            continue
        module = ".".join(file.relative_to(house.parent).with_suffix("").parts)
        declared = vars(importlib.import_module(module)).values()
        found |= {value.name: value for value in declared if isinstance(value, Kernel)}
    return tuple(found[name] for name in sorted(found))


def object_of(kernel: Kernel) -> str:
    """The name of the object that a kernel takes, "" where it takes none."""
    kinds = (each for each in kernel.parameters if isinstance(each, type))
    return next((kind.name for kind in kinds if issubclass(kind, Handle)), "")
