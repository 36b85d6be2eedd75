from .baselines import baselines as baselines
from .comparison import Comparison as Comparison
from .comparison import Figures as Figures
from .comparison import Record as Record
from .figure import draw_comparison as draw_comparison
from .run import evaluate as evaluate
