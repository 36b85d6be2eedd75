from .contours import Contours as Contours
from .contours import trace_contours as trace_contours
from .levels import Levels as Levels
from .levels import plan_levels as plan_levels
from .volume import Volume as Volume
from .volume import volume_above_level as volume_above_level
from .volume import volume_above_mesh as volume_above_mesh
from .volume import volume_above_pixels as volume_above_pixels
