"""The background of one camera: model, training, verdict, and what follows light, noise, shift and moved things."""
