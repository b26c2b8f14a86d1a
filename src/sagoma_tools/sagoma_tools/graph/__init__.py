"""The node graph as processes: started, driven through its lifecycle, watched, restarted, and stopped."""
