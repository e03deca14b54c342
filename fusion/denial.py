"""How badly a solution's ways violate the odometry: a sign that sightings contradict each other."""

import numpy as np

from .models import odometry_terms
from .problem import Problem, State


def denial(problem: Problem, state: State) -> float:
    """χ² of the odometry between two nodes with sightings, where it is violated most; it has three
    degrees of freedom, or six."""
    worst = 0.0
    for name, chain in problem.chains.items():
        if chain.motion is None:
            continue
        robot = state.robots[name]
        motion = chain.motion.rescaled(robot.scales - chain.scales)
        nodes = robot.map_from_base
        terms = odometry_terms(nodes[:-1], nodes[1:], motion, chain.tangent)
        seen = np.zeros(len(chain), dtype=int)
        for batch in problem.batches:
            if batch.robot == name:
                seen[batch.nodes] = 1
        stretch = np.cumsum(seen)[:-1]
        worst = max(worst, float(np.bincount(stretch, np.sum(terms.residual**2, axis=1)).max()))
    return worst
