"""Moved things: what was put down, moved or taken away becomes background, a person never."""
