"""What the three grey levels of a silhouette mean; camera clients, messages and the hull server share them."""

BACKGROUND = 0
SHADOW_CANDIDATE = 127
"""Maybe the person, maybe only floor or wall in shadow: one camera cannot tell, several may."""
FOREGROUND = 255
