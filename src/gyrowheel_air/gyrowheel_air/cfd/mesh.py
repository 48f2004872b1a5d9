"""The mesh: an O-grid in blocks, generated for the rotor upright, then moved to the tilted rotor.

The fluid is what a cylindrical case has left round a cylindrical rotor: 22 blocks, of which nine lie in each end gap
(a square core, four round it up to the rotor's radius, four in the rim gap) and four along the rim. Every tilt has the
same topology, so the solution of one is a first guess for another.

OpenFOAM's own files are read and written here, too: the mesh as points and quadrilaterals (`PolyMesh`), and fields
over its cells.
"""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_air.geometry import Geometry
from gyrowheel_core.errors import InputError

#: Largest tilt for which the moved mesh was checked [rad].
TILT_LIMIT = math.radians(5.0)
#: The core of the O-grid: radius of its corners and of the middle of its sides, in rotor radii.
_CORE, _CORE_SIDE = 0.5, 0.43


@dataclass(frozen=True)
class Resolution:
    """How fine a mesh is."""

    name: str
    #: Cells: round a quarter turn; from the core to the rotor's radius; across the rim gap; across each end
    #: gap; along the rim.
    quadrant: int
    rotor: int
    gap: int
    ends: int
    mid: int
    #: Size of the largest over the smallest cell: across the rim gap and the end gaps (fine at both walls),
    #: along the rim (fine at both edges of the rotor), from the core to the rotor's edge (fine at the edge).
    stretch_gap: float
    stretch_ends: float
    stretch_mid: float
    stretch_rotor: float
    #: Whether the cells at the wall are as large as wall functions need; else they resolve the wall layer.
    wall_functions: bool

    @property
    def cells(self) -> int:
        """Number of cells."""
        rim = 4 * self.quadrant * self.gap
        end = self.quadrant**2 + 4 * self.quadrant * self.rotor + rim
        return 2 * self.ends * end + self.mid * rim


MESHES: Final[dict[str, Resolution]] = {
    r.name: r
    for r in (
        # for a test that a case runs at all; no torque of it means anything
        Resolution("tiny", 4, 4, 4, 5, 6, 1.0, 1.0, 1.0, 1.0, True),
        Resolution("coarse", 12, 12, 10, 14, 20, 1.5, 2.0, 2.0, 3.0, True),
        Resolution("medium", 20, 20, 16, 22, 34, 1.5, 3.0, 3.0, 4.0, True),
        Resolution("fine", 26, 26, 22, 30, 44, 2.0, 4.0, 4.0, 5.0, True),
        Resolution("low_re", 12, 14, 18, 20, 48, 14.0, 40.0, 2.0, 8.0, False),
        Resolution("low_re_fine", 18, 18, 22, 24, 64, 14.0, 40.0, 2.0, 8.0, False),
    )
}


def get_mesh(name: str) -> Resolution:
    """Return a resolution by name; raises InputError for an unknown name."""
    if name not in MESHES:
        raise InputError(f"mesh: {name!r} is not known; allowed: {', '.join(MESHES)}")
    return MESHES[name]


def block_mesh_dict(geometry: Geometry, resolution: Resolution) -> str:
    """Return the text of ``system/blockMeshDict`` for the rotor upright [m]."""
    rotor, case = geometry.rotor_radius, geometry.case_radius
    levels = [
        -0.5 * geometry.case_height,
        -0.5 * geometry.rotor_height,
        0.5 * geometry.rotor_height,
        0.5 * geometry.case_height,
    ]
    radii = [_CORE * rotor, rotor, case]
    middles = [_CORE_SIDE * rotor, rotor, case]

    def vertex(level: int, ring: int, corner: int) -> int:
        return 12 * level + 4 * ring + corner % 4

    vertices = []
    edges = []
    for level, z in enumerate(levels):
        for ring, radius in enumerate(radii):
            for corner in range(4):
                angle = math.radians(45.0 + 90.0 * corner)
                vertices.append(
                    f"    ({_n(radius * math.cos(angle))} {_n(radius * math.sin(angle))} {_n(z)})"
                )
                half = angle + math.radians(45.0)
                middle = (middles[ring] * math.cos(half), middles[ring] * math.sin(half), z)
                edges.append(
                    f"    arc {vertex(level, ring, corner)} {vertex(level, ring, corner + 1)} "
                    f"({' '.join(_n(v) for v in middle)})"
                )
    r = resolution
    gap, ends, mid = (both_sides(r.stretch_gap), both_sides(r.stretch_ends), both_sides(r.stretch_mid))
    out = _n(1.0 / r.stretch_rotor)
    blocks = []
    patches: dict[str, list[str]] = {"rotor": [], "case": []}
    for layer, (count, grade) in enumerate(((r.ends, ends), (r.mid, mid), (r.ends, ends))):
        bottom, top = layer, layer + 1
        if layer != 1:
            square = [vertex(bottom, 0, i) for i in range(4)] + [vertex(top, 0, i) for i in range(4)]
            blocks.append(_block(square, (r.quadrant, r.quadrant, count), ("1", "1", grade)))
        for i in range(4):
            for ring, cells, radial in ((1, r.rotor, out), (2, r.gap, gap)):
                if layer == 1 and ring == 1:
                    continue  # the rotor itself
                corners = [
                    vertex(level, which, where)
                    for level in (bottom, top)
                    for which, where in ((ring - 1, i), (ring, i), (ring, i + 1), (ring - 1, i + 1))
                ]
                blocks.append(_block(corners, (cells, r.quadrant, count), (radial, "1", grade)))
            outer = [vertex(bottom, 2, i), vertex(top, 2, i), vertex(top, 2, i + 1), vertex(bottom, 2, i + 1)]
            patches["case"].append(_face(outer))
    for i in range(4):
        rim = [vertex(1, 1, i), vertex(1, 1, i + 1), vertex(2, 1, i + 1), vertex(2, 1, i)]
        patches["rotor"].append(_face(rim))
    for level, name, rings in ((0, "case", 3), (3, "case", 3), (1, "rotor", 2), (2, "rotor", 2)):
        patches[name].append(_face([vertex(level, 0, i) for i in range(4)]))
        for ring in range(1, rings):
            for i in range(4):
                flat = [vertex(level, ring - 1, i), vertex(level, ring, i)]
                patches[name].append(
                    _face([*flat, vertex(level, ring, i + 1), vertex(level, ring - 1, i + 1)])
                )
    boundary = "\n".join(
        f"    {name}\n    {{\n        type wall;\n        faces\n        (\n"
        + "\n".join(f"            {face}" for face in faces)
        + "\n        );\n    }"
        for name, faces in patches.items()
    )
    return (
        _header("blockMeshDict")
        + "scale 1;\n\nvertices\n(\n"
        + "\n".join(vertices)
        + "\n);\n\nblocks\n(\n"
        + "\n".join(blocks)
        + "\n);\n\nedges\n(\n"
        + "\n".join(edges)
        + f"\n);\n\nboundary\n(\n{boundary}\n);\n\nmergePatchPairs ();\n"
    )


def morph(
    points: NDArray[np.float64], geometry: Geometry, tilt: float, direction: float = 0.0
) -> NDArray[np.float64]:
    """Return the points of the upright mesh moved to a tilted rotor.

    Points on the rotor turn with it as a rigid body; points on the case slide along the case; what lies between follows
    the walls in proportion to its distance.

    `points` (n, 3): points of the upright mesh [m]; `geometry`: rotor and case; `tilt`: angle of the tilt
    [rad], at most `TILT_LIMIT` in size; `direction`: angle of the axis of the tilt from the case's x axis
    [rad]. Raises InputError if the rotor would come too near to the case, or the tilt is beyond the limit.
    """
    check_tilt(geometry, tilt)
    turn = np.array([[math.cos(direction), math.sin(direction)], [-math.sin(direction), math.cos(direction)]])
    x, y = turn @ points[:, :2].T
    z = points[:, 2]
    s, c = math.sin(tilt), math.cos(tilt)
    half, half_case = 0.5 * geometry.rotor_height, 0.5 * geometry.case_height
    f = np.clip(
        (geometry.case_radius - np.hypot(x, y)) / (geometry.case_radius - geometry.rotor_radius), 0.0, 1.0
    )
    g = np.clip((half_case - np.abs(z)) / (half_case - half), 0.0, 1.0)
    # the rotor's share of the sideways motion must not reach the end of the case at full size: it would fold the cells
    share = 0.3 + 0.7 * g
    new_z = z + g * (y * s + z * (c - 1.0))
    new_y = y + f * (y * (c - 1.0) - np.clip(z, -half, half) * s * share)
    back_x, back_y = turn.T @ np.array([x, new_y])
    return np.column_stack([back_x, back_y, new_z])


def check_tilt(geometry: Geometry, tilt: float) -> None:
    """Refuse a tilt for which there is no mesh."""
    if not abs(tilt) <= TILT_LIMIT + 1e-9:
        raise InputError(
            f"tilt: {math.degrees(tilt):g} deg is out of range; the mesh is checked from "
            f"{-math.degrees(TILT_LIMIT):g} to {math.degrees(TILT_LIMIT):g} deg"
        )
    clearance = geometry.clearance(tilt)
    if clearance < 0.1 * geometry.rim_gap:
        raise InputError(
            f"tilt: at {math.degrees(tilt):g} deg the rotor comes within {1e3 * clearance:.2f} mm of the case; "
            f"allowed: a tenth of the rim gap, {1e2 * geometry.rim_gap:.2f} mm"
        )


def both_sides(stretch: float) -> str:
    """Return the grading of blockMesh with the small cells at both ends."""
    return "1" if stretch == 1.0 else f"((0.5 0.5 {_n(stretch)})(0.5 0.5 {_n(1.0 / stretch)}))"


def _block(corners: list[int], cells: tuple[int, int, int], grading: tuple[str, str, str]) -> str:
    return (
        f"    hex ({' '.join(map(str, corners))}) ({' '.join(map(str, cells))}) "
        f"simpleGrading ({' '.join(grading)})"
    )


def _face(corners: list[int]) -> str:
    return f"({' '.join(map(str, corners))})"


def _n(value: float) -> str:
    return f"{value:.10g}"


def _header(name: str) -> str:
    return f"FoamFile\n{{\n    version 2.0;\n    format ascii;\n    class dictionary;\n    object {name};\n}}\n\n"


Array = NDArray[np.float64]
Index = NDArray[np.int64]
_NUMBER = r"[-+.\deEinfa]+"


@dataclass(frozen=True)
class PolyMesh:
    """A mesh of hexahedra."""

    points: Array  # points [m]
    faces: Index  # points of each face, round its rim; the inner faces first
    owner: Index  # the cell on the back of each face
    neighbour: Index  # the cell in front of each inner face
    patches: dict[str, slice]  # the faces of each patch of the boundary

    @classmethod
    def read(cls, folder: Path) -> PolyMesh:
        """Read ``constant/polyMesh`` of a case (ASCII).

        Raises InputError if a file is missing, or a face has other than four corners.
        """
        folder = folder / "constant" / "polyMesh"
        corners = _integers(_list(folder / "faces").translate(_BLANK)).reshape(-1, 5)
        if np.any(corners[:, 0] != 4):
            raise InputError(f"{folder / 'faces'}: a face has other than 4 corners")
        patches = {}
        for name, body in re.findall(r"(\w+)\s*\{([^}]*)\}", (folder / "boundary").read_text()):
            start, count = (re.search(rf"{key}\s+(\d+);", body) for key in ("startFace", "nFaces"))
            if start and count:
                patches[name] = slice(int(start.group(1)), int(start.group(1)) + int(count.group(1)))
        return cls(
            points=read_points(folder / "points"),
            faces=corners[:, 1:],
            owner=_integers(_list(folder / "owner")),
            neighbour=_integers(_list(folder / "neighbour")),
            patches=patches,
        )

    @property
    def cells(self) -> int:
        """Number of cells."""
        return int(self.owner.max()) + 1

    @functools.cached_property
    def face_centres(self) -> Array:
        """Centres of the faces [m], shape (f, 3)."""
        centres, areas = self._triangles
        return np.asarray((centres * areas[..., None]).sum(axis=1) / areas.sum(axis=1)[:, None])

    @functools.cached_property
    def face_areas(self) -> Array:
        """Areas of the faces as vectors out of the owner [m^2], shape (f, 3)."""
        p = self.points[self.faces]
        return np.asarray(0.5 * np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1]))

    @functools.cached_property
    def _triangles(self) -> tuple[Array, Array]:
        p = self.points[self.faces]
        middle = p.mean(axis=1, keepdims=True)
        following = np.roll(p, -1, axis=1)
        areas = 0.5 * np.linalg.norm(np.cross(p - middle, following - middle), axis=2)
        return np.asarray((p + following + middle) / 3.0), np.asarray(areas, dtype=np.float64)

    @functools.cached_property
    def _pyramids(self) -> tuple[Array, Array]:
        inner = len(self.neighbour)
        cells = np.concatenate([self.owner, self.neighbour])
        faces = np.concatenate([np.arange(len(self.owner)), np.arange(inner)])
        sign = np.concatenate([np.ones(len(self.owner)), -np.ones(inner)])
        count = np.bincount(cells, minlength=self.cells)
        middle = _gather(cells, self.face_centres[faces], self.cells) / count[:, None]
        out = self.face_areas[faces] * sign[:, None]
        volumes = np.einsum("ij,ij->i", self.face_centres[faces] - middle[cells], out) / 3.0
        volume: Array = np.bincount(cells, volumes, self.cells).astype(np.float64)
        heart = 0.75 * self.face_centres[faces] + 0.25 * middle[cells]
        return _gather(cells, heart * volumes[:, None], self.cells) / volume[:, None], volume

    @property
    def cell_centres(self) -> Array:
        """Centres of the cells [m], shape (cells, 3)."""
        return self._pyramids[0]

    @property
    def volumes(self) -> Array:
        """Volumes of the cells [m^3], shape (cells,)."""
        return self._pyramids[1]

    def wall_distance(self, patch: str) -> Array:
        """Return the distances of the cells at a patch from it [m], one a face."""
        faces = self.patches[patch]
        normal = self.face_areas[faces] / np.linalg.norm(self.face_areas[faces], axis=1)[:, None]
        between = self.face_centres[faces] - self.cell_centres[self.owner[faces]]
        return np.asarray(np.einsum("ij,ij->i", between, normal))


def read_points(path: Path) -> Array:
    """Read the points of a mesh [m], shape (n, 3)."""
    return _floats(_list(path).translate(_BLANK)).reshape(-1, 3)


def write_points(path: Path, points: Array) -> None:
    """Write the points of a mesh [m]."""
    path.write_text(
        _head("vectorField", "points", "constant/polyMesh") + f"{len(points)}\n(\n{_vectors(points)}\n)\n",
        encoding="utf-8",
    )


def read_field(path: Path, cells: int) -> Array:
    """Read the values of a field in the cells: shape (cells,) or (cells, 3)."""
    text = path.read_text(encoding="utf-8")
    return _values(text, "internalField", cells, path)


def read_patch(path: Path, patch: str, faces: int) -> Array:
    """Read the values of a field on a patch: shape (faces,) or (faces, 3)."""
    text = path.read_text(encoding="utf-8")
    begin = text.index("boundaryField")
    found = re.compile(rf"\b{patch}\s*\{{").search(text, begin)
    if found is None:
        raise InputError(f"{path}: no patch '{patch}'")
    return _values(text[found.end() :], "value", faces, path)


def write_field(
    path: Path, name: str, dimensions: str, values: Array | float, patches: dict[str, str]
) -> None:
    """Write a field over the cells.

    `path`: file, in a time folder of a case; `name`, `dimensions`: name, and dimensions as OpenFOAM writes
    them without the brackets; `values`: values in the cells, shape (cells,) or (cells, 3); a number holds
    everywhere. `patches`: text of the boundary condition of each patch.
    """
    vector = not isinstance(values, float) and values.ndim == 2
    if isinstance(values, float):
        inner = f"uniform {values:.8g}"
    else:
        kind = "vector" if vector else "scalar"
        body = _vectors(values) if vector else "\n".join(map("{:.8g}".format, values.tolist()))
        inner = f"nonuniform List<{kind}>\n{len(values)}\n(\n{body}\n)\n"
    boundary = "\n".join(f"    {patch}\n    {{\n        {text}\n    }}" for patch, text in patches.items())
    path.write_text(
        _head("volVectorField" if vector else "volScalarField", name, path.parent.name)
        + f"dimensions [{dimensions}];\n\ninternalField {inner};\n\nboundaryField\n{{\n{boundary}\n}}\n",
        encoding="utf-8",
    )


_BLANK = str.maketrans("()", "  ")


def _list(path: Path) -> str:
    """Return what stands between the outer parentheses of a list file."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    text = path.read_text(encoding="utf-8")
    begin = text.index("(", re.search(r"^\s*\d+\s*$", text, re.MULTILINE).end())  # type: ignore[union-attr]
    return text[begin + 1 : text.rindex(")")]


def _values(text: str, key: str, count: int, path: Path) -> Array:
    found = re.compile(
        rf"\b{key}\s+(?:uniform\s+(\([^)]*\)|{_NUMBER})|nonuniform\s+List<(scalar|vector)>\s*\d+\s*\()"
    ).search(text)
    if found is None:
        raise InputError(f"{path}: no '{key}' that can be read")
    if found.group(1) is not None:
        value = _floats(found.group(1).translate(_BLANK))
        return np.tile(value, (count, 1)) if len(value) > 1 else np.full(count, value[0])
    if found.group(2) == "scalar":
        result = _floats(text[found.end() : text.index(")", found.end())])
    else:
        end = re.compile(r"\)\s*\)").search(text, found.end())
        inner = text[found.end() : end.start() if end else len(text)]
        result = _floats(inner.translate(_BLANK)).reshape(-1, 3)
    if len(result) != count:
        raise InputError(f"{path}: {key} holds {len(result)} values, {count} are expected")
    return result


def _floats(text: str) -> Array:
    return np.array(text.split(), dtype=np.float64)


def _integers(text: str) -> Index:
    return np.array(text.split(), dtype=np.int64)


def _gather(cells: Index, values: Array, count: int) -> Array:
    return np.column_stack([np.bincount(cells, values[:, i], count) for i in range(3)])


def _vectors(values: Array) -> str:
    return "\n".join("({:.9g} {:.9g} {:.9g})".format(*row) for row in values.tolist())


def _head(kind: str, name: str, location: str) -> str:
    return (
        f"FoamFile\n{{\n    version 2.0;\n    format ascii;\n    class {kind};\n"
        f'    location "{location}";\n    object {name};\n}}\n\n'
    )
