"""Reading and writing OpenFOAM's own files: the mesh as points and quadrilaterals, and fields over its cells."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError

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
