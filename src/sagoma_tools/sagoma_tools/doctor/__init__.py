"""What may keep a camera PC from working, found before it does: facts are collected, judged, and shown with remedies."""
