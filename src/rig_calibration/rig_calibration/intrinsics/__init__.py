"""One camera's lens from views of a board: which views, the adjustment, how sure it is, and whether it will do."""
