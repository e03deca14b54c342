"""The network that a fixed map holds, and what a map that was learnt hands over to it."""

from collections.abc import Mapping
from functools import cached_property
from uuid import UUID

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.errors import OperationError
from trigpoint.fusion.estimators.interface import CameraEstimate
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.model.dataset import Conclusions
from trigpoint.fusion.model.inputs import Inputs
from trigpoint.fusion.model.known_cameras import Creep, KnownCameras, known_cameras
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import CameraModel
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import CameraRecord, Network
from trigpoint.site.config import Site


class FixedNetwork(Struct, frozen=True, eq=False, dict=True):
    """A network with the joint covariance (6n, 6n) of its located cameras. `known`: those that the
    site has too; `learnt`: what was concluded of noise while it was learnt, where that is at
    hand."""

    network: Network
    covariance: Array
    known: KnownCameras
    learnt: Conclusions | None = None

    @classmethod
    def of(cls, results: Results, site: Site, learnt: Conclusions) -> "FixedNetwork":
        """The network of a map that was learnt; raise OperationError where it locates nothing."""
        known = known_cameras(
            results.network, results.covariance, site.cameras, creep=Creep.of_all(site.cameras)
        )
        if not known.poses:
            raise OperationError(
                "no camera is located, so there is no map to hold fixed; let a robot drive past "
                "the cameras with learn = true first"
            )
        return cls(results.network, results.covariance, known, learnt)

    @property
    def map_id(self) -> UUID | None:
        """The map's identity, which is the network's; None where its file has none."""
        try:
            return UUID(self.network.map_id)
        except ValueError:
            return None

    @property
    def results(self) -> Results:
        """The network as it was given."""
        return Results(self.network, self.covariance, {})

    @cached_property
    def records(self) -> Mapping[str, CameraRecord]:
        """The located cameras of the site."""
        return {name: self.network.cameras[name] for name in self.known.poses}

    @cached_property
    def lenses(self) -> dict[str, CameraModel]:
        """Their lenses, as the network has them."""
        return {name: _lens(record) for name, record in self.records.items()}

    @cached_property
    def states(self) -> dict[str, CameraState]:
        """The cameras as they stay."""
        return {
            name: CameraState(self.known.poses[name], self.lenses[name], record.time_offset)
            for name, record in self.records.items()
        }

    def estimates(self, known: KnownCameras) -> dict[str, CameraEstimate]:
        """The cameras as they are given out; `known`: as uncertain as they are now."""
        covariance = known.covariance
        return {
            name: CameraEstimate(
                self.known.poses[name],
                covariance[6 * row : 6 * row + 6, 6 * row : 6 * row + 6],
                self.lenses[name],
                _lens_sigma(self.records[name]),
                self.records[name].time_offset,
                self.records[name].time_offset_sigma,
            )
            for row, name in enumerate(known.poses)
        }

    def scales(self, robot: str) -> Array:
        """A robot's odometry scale errors of distance and heading, (2,); 0 where none are known."""
        record = self.network.robots.get(robot)
        if record is None:
            return np.zeros(2)
        return np.array([record.distance_scale, record.heading_scale]) - 1

    def inputs(self, inputs: Inputs) -> Inputs:
        """The inputs of a map with this network, instead of what they know beforehand."""
        return replace(inputs, lenses=inputs.lenses | self.lenses, known=self.known)


def _lens(record: CameraRecord) -> CameraModel:
    assert record.intrinsics is not None  # located cameras have a lens
    return record.intrinsics.camera


def _lens_sigma(record: CameraRecord) -> Array:
    assert record.intrinsics is not None  # located cameras have a lens
    sigma = record.intrinsics.sigma
    return np.array([sigma.fx, sigma.fy, sigma.cx, sigma.cy, *sigma.d])
