"""Hull server: frame sets of silhouettes in, visual hull, slices and centerline points out."""
