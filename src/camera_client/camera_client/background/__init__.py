"""The background of one camera: model, noise, training, verdict, watch; its adaptation; things that moved."""
