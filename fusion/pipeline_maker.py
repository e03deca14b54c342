"""Makes the pipeline of each map that begins or goes on, with the solver that works beside it."""

from collections.abc import Callable
from pathlib import Path

from msgspec.structs import replace

from .checkpoint import PAST
from .fixed.network import FixedNetwork
from .live.solver_messages import Solver
from .model.inputs import Inputs
from .past_file import load_past
from .pipeline import Pipeline


class PipelineMaker:
    """`folder`: of the map; `make_solver`: None for estimators that need no solver. `solver`: that
    of the last pipeline, None where nothing solves for it. Not thread-safe."""

    def __init__(
        self, inputs: Inputs, folder: Path, make_solver: Callable[[Inputs], Solver] | None
    ) -> None:
        self._inputs, self._folder, self._make_solver = inputs, folder, make_solver
        self.solver: Solver | None = None

    def make(self, fixed: FixedNetwork | None, *, is_live: bool = True) -> Pipeline:
        """The pipeline of a map that is held, or else begins or goes on from its past; the solver
        of the one before ends."""
        self.close()
        if fixed is not None:
            return Pipeline(self._inputs, fixed=fixed)
        past = load_past(self._folder / PAST, self._inputs.site, self._inputs.targets)
        inputs = replace(self._inputs, past=past)
        if self._make_solver is not None:
            self.solver = self._make_solver(inputs)
        return Pipeline(inputs, is_live=is_live, solver=self.solver)

    def close(self) -> None:
        """End the solver, whatever it is doing."""
        if self.solver is not None:
            self.solver.close()
        self.solver = None
