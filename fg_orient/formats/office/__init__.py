"""Tables of offices and surveyors, whose form is found out: encoding, separator, header, columns, units, CRS."""
