"""Session folders of the studio: footage, exact silhouettes, boards and truth, written to files."""
