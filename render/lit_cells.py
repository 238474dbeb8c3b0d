"""The cells of a scene as it stands, and what they send on: how light goes from surface to surface before it is seen.

The ways that splat surfels, which themselves bring light to the camera alone, need them for that only: surfels then
send what the cells around them reflect, besides what glows there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phoslab.render.cell_glow import CellGlow
from phoslab.render.cell_light import CellLight, leaf_reflectances, middles
from phoslab.render.cell_rays import CellTree
from phoslab.render.cells import Cells, build_cells
from phoslab.render.device import Device
from phoslab.render.glow_transport import Surroundings, TransportParameters
from phoslab.render.gpu_scene import GpuDrawable

Array = NDArray[np.float64]

# Cells around a surfel between whose light its own is interpolated.
AROUND = 4
# A cell that faces another way by half a right angle counts as one that is a cell's side farther away.
TURNED = 1.3


class LitCells:
    """Cells, what they emit, and what they reflect.

    Attributes:
        cells, cell_glow: as `place` made them.
        tree, cell_light: the same; None where light does not go from cell to cell.
        n_bands: of the scene.
        drawables: in the order in which cells have them.
    """

    cells: Cells
    cell_glow: CellGlow
    tree: CellTree | None = None
    cell_light: CellLight | None = None

    def __init__(self, device: Device, surroundings: Surroundings, parameters: TransportParameters) -> None:
        self._device, self._around, self._parameters = device, surroundings, parameters
        self.n_bands = surroundings.scene.transport.n
        self.drawables = surroundings.drawables
        self._placed: list[bytes] = []

    def place(self) -> None:
        """Make the cells, and find what they see of each other, where drawables have moved since the last time."""
        around, p, device = self._around, self._parameters, self._device
        placed = [d.drawable.model_to_world.tobytes() for d in around.drawables]
        if placed == self._placed:
            return
        if self._placed:
            for made in (self.cell_glow, self.cell_light, self.tree):
                if made is not None:
                    made.release()
        self._placed = placed
        self.cells = build_cells(around.drawables, p.cell)
        self.cell_glow = CellGlow(device, self.cells, around.glows, self.n_bands)
        if p.follows_cells:
            atlases = {g.drawable.number: a for g, a in zip(around.glows, around.atlases, strict=True)}
            self.tree = CellTree(device, self.cells)
            reflectances = leaf_reflectances(self.cells, around.drawables, atlases)
            lamps = around.lamps if p.lamps else None
            self.cell_light = CellLight(device, self.tree, reflectances, self.n_bands, p.bounces, lamps)

    def reflected(self) -> Array:
        """Return (m, 2, 4 layers) the radiance that the front and the back of each smallest cell reflect."""
        assert self.cell_light is not None
        emitted = self.cell_glow.emitted()
        total = self.cell_light.spread(emitted)
        total[:, 0] -= emitted
        return np.maximum(total, 0.0)


def cells_around(
    cells: Cells, drawables: Sequence[GpuDrawable], surfels: NDArray[np.float32]
) -> tuple[NDArray[np.intp], Array]:
    """Return (n, k) the smallest cells that lie and face as each surfel does, and (n, k) their weights.

    Args:
        drawables: in the order in which the cells have them.
        surfels: (n, 12) as `Surfels` holds them; cells and surfels have the same coordinates.
    """
    from scipy.spatial import cKDTree

    points, normals = middles(cells)
    size = float(np.sqrt(np.median(cells.leaf_areas)))
    features = np.concatenate([points, TURNED * size * normals], axis=1)
    wanted = np.concatenate([surfels[:, :3], TURNED * size * surfels[:, 4:7]], axis=1).astype(np.float64)
    leaf, weight = np.zeros((len(surfels), AROUND), dtype=np.intp), np.zeros((len(surfels), AROUND))
    for k, drawable in enumerate(drawables):
        first, end = cells.owners[k], cells.owners[k + 1]
        of = np.flatnonzero(surfels[:, 7] == drawable.number)
        if not len(of) or first == end:
            continue
        n = min(AROUND, int(end - first))
        away, near = cKDTree(features[first:end]).query(wanted[of], k=[*range(1, n + 1)])
        leaf[of, :n] = first + near
        # The farthest of them weighs nothing, so that light is continuous.
        weight[of, :n] = np.maximum(1 / np.maximum(away, 1e-9) - (1 / away[:, -1:] if n > 1 else 0.0), 1e-9)
    return leaf, weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-30)
