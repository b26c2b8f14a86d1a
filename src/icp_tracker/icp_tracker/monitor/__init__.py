"""Judges every fitted pose, tries others, and changes over to a better one."""
