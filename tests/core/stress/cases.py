"""All cases, by name."""

from __future__ import annotations

from importlib.util import find_spec

from .boxes import boxes, rotations, scaled
from .counts import counts, odd_images
from .density import grazed, intervals, sharpness
from .followers import followers
from .functions import functions
from .lenses import lens_edges, lens_images, lens_points
from .logs import LAYOUTS, far_logs
from .measures import Case
from .places import FAR_OFF, moved, training_data
from .rays import axes, faces, inside, unsound
from .sums import accumulated
from .truths import changed
from .vehicles import vehicles
from .weights import largest_halves, largest_weights, not_numbers, opaque_and_empty

CASES: dict[str, Case] = {
    **{where: moved(where) for where in FAR_OFF},
    "training data far off": training_data,
    **{f"beta {beta:g}": sharpness(beta) for beta in (1.0, 30.0, 1e3, 1e4)},
    "intervals": intervals,
    "grazed at 0.1 degrees": grazed,
    "from inside": inside,
    "along axes": axes,
    "along faces": faces,
    "rays that are none": unsound,
    "boxes of 1 cm and 50 m": boxes,
    "scaled actors": scaled,
    "6D rotations": rotations,
    "opaque and empty": opaque_and_empty,
    "largest halves": changed(largest_halves, 1e-3),
    "weights of 1000": changed(largest_weights, 1e-3),
    "NaN in the kernels": not_numbers,
    "one ray and many": counts,
    "odd images": odd_images,
    "100 000 intervals": accumulated,
    "functions": functions,
    "lenses at the edge": lens_edges,
    "points through lenses": lens_points,
    "images through lenses": lens_images,
    "simulated vehicle": vehicles,
    "car following": followers,
    **{
        f"{layout}, far off and later": far_logs(layout)
        for layout, (_, needs, _) in LAYOUTS.items()
        if not needs or find_spec(needs)
    },
}
