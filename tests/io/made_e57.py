"""E57 files made node by node, so that they have what files of scanners have and no writer of ours."""

import numpy as np
from pye57 import E57, libe57


def write_e57(path, scans):
    """Write scans, dictionaries of ``fields`` (name: floats, integers or ``Scaled``) and of what else they have."""
    with E57(str(path), mode="w") as file:
        image = file.image_file
        image.extensionsAdd("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
        image.extensionsAdd("las", "http://www.hobu.co/las")
        for scan in scans:
            _write_scan(file, image, **scan)
    return path


class Scaled(np.ndarray):
    """Numbers that are stored as integers of a tenth of a millimeter."""


def scaled(values):
    return np.asarray(values, dtype=float).view(Scaled)


def _write_scan(file, image, fields, name=None, rotation=None, translation=None, pose=True, limits=None, maximum=None):
    scan = libe57.StructureNode(image)
    scan.set("guid", libe57.StringNode(image, "{0}"))
    if name is not None:
        scan.set("name", libe57.StringNode(image, name))
    if pose and (rotation is not None or translation is not None):
        node = libe57.StructureNode(image)
        scan.set("pose", node)
        for part, names, values in (("rotation", "wxyz", rotation), ("translation", "xyz", translation)):
            if values is not None:
                node.set(part, _numbers(image, names, values))
    if limits is not None:
        names = [f"color{color}{end}" for color in ("Red", "Green", "Blue") for end in ("Minimum", "Maximum")]
        node = libe57.StructureNode(image)
        for key, value in zip(names, [0, limits] * 3, strict=True):
            node.set(key, libe57.IntegerNode(image, value))
        scan.set("colorLimits", node)
    prototype = libe57.StructureNode(image)
    for key, values in fields.items():
        prototype.set(key, _prototype(image, key, values, maximum))
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    scan.set("points", points)
    file.data3d.append(scan)
    buffers = libe57.VectorSourceDestBuffer()
    arrays = [np.ascontiguousarray(values, dtype=float) for values in fields.values()]
    for key, array in zip(fields, arrays, strict=True):
        buffers.append(libe57.SourceDestBuffer(image, key, array, max(len(array), 1), True, True))
    writer = points.writer(buffers)
    if len(arrays[0]):
        writer.write(len(arrays[0]))
    writer.close()


def _numbers(image, names, values):
    node = libe57.StructureNode(image)
    for key, value in zip(names, values, strict=True):
        node.set(key, libe57.FloatNode(image, float(value)))
    return node


def _prototype(image, key, values, maximum):
    if isinstance(values, Scaled):
        return libe57.ScaledIntegerNode(image, 0, -(2**31), 2**31 - 1, 1e-4, 0.0)
    if values.dtype.kind in "iu":
        largest = maximum if maximum is not None and key.startswith("color") else 65535
        return libe57.IntegerNode(image, 0, -66 if key == "intensity" else 0, largest)
    return libe57.FloatNode(image, 0.0)
