"""Public names of a package, loaded on first use (PEP 562): importing the package imports none of its modules."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def on_first_use(package: dict[str, Any], home: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` function of a package.

    Parameters
    ----------
    package : dict
        ``globals()`` of the package.
    home : mapping
        Module that defines each public name; ``module:name`` if the name there differs.
    """

    def load(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
        module, _, original = home[name].partition(":")
        value = package[name] = getattr(import_module(module), original or name)
        return value

    return load


def names_of(package: str, modules: Mapping[str, str]) -> dict[str, str]:
    """Return the full module of each public name; ``modules`` gives names, separated by blanks, for each module."""
    return {name: f"{package}.{module}" for module, names in modules.items() for name in names.split()}
