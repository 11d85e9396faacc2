"""Files in and out: metadata, tables, project files."""
