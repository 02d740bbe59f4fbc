"""The eight road structures of K-Radar; each builder draws one sequence's layout."""

from collections.abc import Callable

from farfield.simulation.world.layout import RoadLayout
from farfield.simulation.world.roads.alleyway import build_alleyway
from farfield.simulation.world.roads.common import RoadBuild
from farfield.simulation.world.roads.highway import build_highway, build_shoulder
from farfield.simulation.world.roads.mountain import build_mountain
from farfield.simulation.world.roads.parking_lot import build_parking_lot
from farfield.simulation.world.roads.suburban import build_suburban
from farfield.simulation.world.roads.university import build_university
from farfield.simulation.world.roads.urban import build_urban

__all__ = ["BUILDERS", "RoadBuild"]

BUILDERS: dict[str, Callable[[RoadBuild], RoadLayout]] = {
    "urban": build_urban,
    "highway": build_highway,
    "alleyway": build_alleyway,
    "suburban": build_suburban,
    "university": build_university,
    "mountain": build_mountain,
    "parking_lot": build_parking_lot,
    "shoulder": build_shoulder,
}
