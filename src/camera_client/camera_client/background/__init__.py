"""The background of one camera: model, light, noise, displacement, training, verdict, causes; things that moved."""
