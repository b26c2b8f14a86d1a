"""What may keep a camera PC from working, found before it does: facts are collected and judged, remedies shown."""
