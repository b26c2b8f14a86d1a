"""The hull's surface as triangles, for viewers and other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from capture_rig import InputError
from capture_rig.files import make_folder, replaced_file

from .grid import BRICK_EDGE, Array, BrickVolume

SURFACE_LEVEL = 0.5  # of an occupancy between 0 and 1
PLY_HEADER = """ply
format binary_little_endian 1.0
comment metres, map frame, z up
element vertex {vertices}
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
end_header
"""
PLY_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", (3,))])


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed surface: vertices_world (v, 3) metres, map frame; faces (f, 3) vertex numbers, outside anticlockwise."""

    vertices_world: Array
    faces: npt.NDArray[np.int32]

    @property
    def litres(self) -> float:
        """The volume enclosed (sum of signed tetrahedra)."""
        a, b, c = (self.vertices_world[self.faces[:, i]] for i in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0 * 1e3


def surface_mesh(volume: BrickVolume, smoothing_voxels: float = 0.0) -> Mesh:
    """Extract the surface between occupied and empty voxels, by marching cubes (Lorensen and Cline 1987).

    smoothing_voxels : standard deviation of a Gaussian over the occupancy first; 0 leaves the voxels' steps, 1 rounds
    them off and removes parts thinner than about two voxels. InputError for an empty or a vanishing hull.
    """
    if not len(volume.index):
        raise InputError(
            "the hull is empty: there is nothing to make a mesh of",
            remedy="Ask again when a person stands in the capture volume.",
        )
    occupancy, low = _crop(volume, margin=2 + int(np.ceil(3 * smoothing_voxels)))
    occupancy = gaussian_filter(occupancy, smoothing_voxels)
    if occupancy.max() <= SURFACE_LEVEL:
        raise InputError("the hull is thinner than the smoothing", remedy="Set mesh.smoothing_voxels to 0.")
    vertices, faces, _, _ = marching_cubes(occupancy, SURFACE_LEVEL, gradient_direction="ascent")
    return Mesh(volume.grid.centres_world(vertices + low), faces.astype(np.int32))


def write_ply(mesh: Mesh, path: Path) -> None:
    """Write the mesh as binary PLY (Turk 1994), metres, map frame; InputError when the file cannot be written."""
    faces = np.empty(len(mesh.faces), PLY_FACE)
    faces["count"], faces["vertices"] = 3, mesh.faces
    make_folder(path.parent)
    with replaced_file(path) as file:
        file.write(PLY_HEADER.format(vertices=len(mesh.vertices_world), faces=len(faces)).encode("ascii"))
        file.write(mesh.vertices_world.astype("<f4").tobytes())
        file.write(faces.tobytes())


def _crop(volume: BrickVolume, margin: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64]]:
    """Crop the occupancy (0 or 1) to a box around the hull, empty on all sides; also return the voxel of its low
    corner."""
    corners = volume.brick_corners()
    low, high = corners.min(axis=0) - margin, corners.max(axis=0) + BRICK_EDGE + margin
    occupancy = np.zeros(high - low, np.float32)
    occupancy[tuple((volume.voxels() - low).T)] = 1.0
    return occupancy, low
