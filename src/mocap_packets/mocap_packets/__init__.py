"""What travels between the stages of the pipeline: one frozen type each, with its array layout."""
