"""Messages about statistics: variance components, significance, reduction of unknowns."""

from __future__ import annotations

from typing import Final

STATISTICS: Final = {
    "statistics.groups": ("there is no such grouping of observations", "choose among {known}"),
    "statistics.groups_overlap": (
        "these groupings overlap: an observation has one variance component",
        "keep one grouping of image points, and either control or position and height",
    ),
    "statistics.method": ("there is no such method of variance components", "choose one of {known}"),
    "statistics.components_loss": (
        "variance components under a robust loss: its weights take from the large residuals, so all would be too small",
        'leave the loss out; the method "median" withstands gross errors, or search them first',
    ),
    "statistics.component_negative": (
        "the variance component runs to zero or below: with a redundancy of {value} the residuals of this group are "
        "smaller than any error of it would leave",
        "its sigmas cannot be told from those of another group: leave it out of the groups, or join the two",
    ),
    "statistics.component_explodes": (
        "the variance component runs away: the sigmas would have to be {value} times as large",
        "check the units of the sigmas, and search for gross errors or a wrong model first",
    ),
    "statistics.component_unsettled": (
        "the variance component does not stand after {value} adjustments",
        "leave it out of the groups, or join it with another",
    ),
    "statistics.snoop_loss": (
        "gross errors are searched with least squares, not under a robust loss that has weighted them down",
        "leave out the loss, or the search",
    ),
    "statistics.snoop_components": (
        "gross errors and variance components are not searched in one run: each would hide the other",
        "search the gross errors first, then leave them out and estimate the components",
    ),
    "statistics.too_few": ("too few observations", "{remedy}"),
    "statistics.motions": ("nothing fixes these images in the world", "{remedy}"),
}
