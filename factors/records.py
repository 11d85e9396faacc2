"""Flat arrays of constants whose fields have names, used by kernels and by the code that fills the arrays."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Record(ModuleType):
    """Names of the fields of a flat record, defined by one list.

    ``RECORD.tau`` is the index of a field with one number, ``RECORD.mounting`` the slice of a longer field,
    and ``RECORD.size`` the size of the record. In arrays with stride n, observation i has a one-number field
    at ``i + RECORD.tau * n``; a longer field begins at ``i + RECORD.mounting.start * n``. The class is
    derived from ModuleType, because numba treats attributes of modules as compile-time constants.

    Parameters
    ----------
    **fields : int or str
        Fields in the order of the record; the value is the count of numbers in the field, or their names.
    """

    def __init__(self, **fields: int | str) -> None:
        super().__init__("record")
        self.fields, self.size = fields, 0
        self.sizes: dict[str, int] = {}
        for name, field in fields.items():
            parts = field.split() if isinstance(field, str) else []
            size = len(parts) if isinstance(field, str) else field
            for k, part in enumerate(parts):
                setattr(self, part, self.size + k)
            setattr(self, name, slice(self.size, self.size + size) if size > 1 else self.size)
            self.sizes[name] = size
            self.size += size

    def pack(self, **values: Any) -> Array:
        """Return records (..., size) made from all fields: (...) for a field with one number, (..., k) for k numbers.

        Raises
        ------
        ValueError
            A field is missing, unknown or of another size, or leading axes do not match.
        """
        if values.keys() != self.sizes.keys():
            raise ValueError(f"missing or unknown fields: {sorted(values.keys() ^ self.sizes.keys())}")
        parts = {name: np.asarray(value, float) for name, value in values.items()}
        for name, size in self.sizes.items():
            if size > 1 and parts[name].shape[-1:] != (size,):
                raise ValueError(f"field {name!r}: {size} numbers expected, shape {parts[name].shape} given")
        shape = np.broadcast_shapes(*(p.shape[:-1] if self.sizes[n] > 1 else p.shape for n, p in parts.items()))
        out = np.empty((*shape, self.size))
        for name, part in parts.items():
            out[..., getattr(self, name)] = part
        return out
