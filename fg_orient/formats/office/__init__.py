"""Read tables from offices and surveyors whose encoding, separator, header, columns, units and CRS are unknown."""
