"""The order of the steps of an adjustment, and the object that it returns."""
