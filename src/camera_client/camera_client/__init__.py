"""Camera client: frames from a GigE Vision camera or footage in, undistorted silhouettes out."""

__version__ = "0.1.0"
