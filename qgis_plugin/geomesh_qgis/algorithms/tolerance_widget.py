"""The field of the tolerance in the dialog of DEM to TIN: it shows the value if none is set."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from qgis.core import QgsProcessingContext, QgsProject

if TYPE_CHECKING:
    from collections.abc import Iterable

    from qgis.core import QgsProcessingParameterDefinition
    from qgis.gui import QgsAbstractProcessingParameterWidgetWrapper as Wrapper

# Pixels from which the dialog guesses the range: it must not wait for all of a large raster.
_SAMPLE = 250_000


class ToleranceWidget:
    """Makes the usual field of a number, which follows the fields of DEM and band."""

    def __new__(
        cls, parameter: QgsProcessingParameterDefinition, dialog: Any, row: int = 0, col: int = 0
    ) -> Wrapper:
        """Return the wrapper of the field. Processing calls this by the parameter's metadata."""
        from processing.gui.wrappers import WidgetWrapperFactory

        plain = parameter.clone()
        plain.setMetadata({})  # or this class would be called again
        wrapper = WidgetWrapperFactory.create_wrapper(plain, dialog, row, col)
        wrapper.geomesh_parameter = plain  # the wrapper does not own it
        # Processing calls this when all fields are there. If another version does not, the field
        # just says that nothing is set.
        wrapper.postInitialize = partial(_follow, wrapper)
        return wrapper


def _follow(wrapper: Wrapper, wrappers: Iterable[Wrapper]) -> None:
    """Show the default tolerance again each time that another DEM or band is chosen."""
    others = {each.parameterDefinition().name(): each for each in wrappers}
    chosen = [others.get(name) for name in ("INPUT", "BAND")]
    if None in chosen:
        return

    def show(*_: object) -> None:
        _show(wrapper, *chosen)

    for each in chosen:
        each.widgetValueHasChanged.connect(show)
    show()


def _show(wrapper: Wrapper, dem: Wrapper, band: Wrapper) -> None:
    field = wrapper.wrappedWidget()
    if not hasattr(field, "setClearValue"):
        return  # in a model, where the DEM is not known
    context = QgsProcessingContext()
    context.setProject(QgsProject.instance())
    given = {"INPUT": dem.parameterValue(), "BAND": band.parameterValue()}
    tolerance = _guess(given, context)
    text = "Not set" if tolerance is None else f"About {tolerance:.2g}, a hundredth of the range"
    field.setClearValue(field.minimum(), f"{text} of heights" if tolerance is not None else text)


def _guess(given: dict[str, Any], context: QgsProcessingContext) -> float | None:
    """Return about the tolerance that the algorithm takes if none is set."""
    from .dem_to_tin import DemToTin

    algorithm = DemToTin()
    algorithm.initAlgorithm()
    layer = algorithm.parameterAsRasterLayer(given, "INPUT", context)
    number = algorithm.parameterAsInt(given, "BAND", context)
    if layer is None or not layer.isValid() or not 1 <= number <= layer.bandCount():
        return None
    if layer.providerType() != "gdal":
        return None  # a web service would be asked for pixels
    found = layer.dataProvider().bandStatistics(number, sampleSize=_SAMPLE)
    span = found.maximumValue - found.minimumValue
    return span / 100 if 0 < span < float("inf") else None
