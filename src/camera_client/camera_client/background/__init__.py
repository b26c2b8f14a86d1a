"""The background of one camera: model, noise, training, verdict, causes; its adaptation; things that moved."""
