from .contours import Contours as Contours
from .contours import trace_contours as trace_contours
from .levels import Levels as Levels
from .levels import plan_levels as plan_levels
