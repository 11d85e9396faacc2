"""Work with RPC files: check, convert, refine with control points, fit to points or to a rigorous model."""

from __future__ import annotations

from fg_orient.model.public import names_of, on_first_use

_HOME = names_of(
    __name__,
    {
        "check": "check_rpc",
        "compensate": "Compensation",
        "estimate": "fit_linear fit_true fit_weighted",
        "fit": "CrossValidation RfmFit cross_validate",
        "form": "RfmForm",
        "points": "ControlPoints MeasuredPoints read_gcp read_measured",
        "select": "fit_selected",
        "virtual_grid": "SensorRfm fit_sensor",
    },
)
__all__ = sorted(_HOME)
__getattr__ = on_first_use(globals(), _HOME)
