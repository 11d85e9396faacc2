"""Read and write files: metadata, tables and project files."""
