"""Motion as files of other programs: BVH, glTF, C3D, TRC, OpenSim, CSV; joint angles of the ISB."""
