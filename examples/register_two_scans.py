"""Registers two scans from files, says whether the pose can be trusted, and writes the one in the frame of the other.

The two files here are simulated; put the names of yours in their place and leave out the three lines that make them.
"""

import torchreg as tr

hall = tr.datasets.mall(seed=1, angular_step=1.2)  # scanned from two stations, in different light
tr.write_cloud("a.ply", hall.source)
tr.write_cloud("b.ply", hall.target)

source, target = tr.read_cloud("a.ply"), tr.read_cloud("b.ply")
result = tr.register(source, target)  # all lengths follow from the spacing of the points
print(result.explain())  # what each stage kept, which poses were weighed, how likely the best one is right
if result.success:
    T = result.T_target_source[0]  # 4x4 float64 in meters: x_target = R x_source + t
    print(T)
    tr.write_cloud("a_in_b.ply", source, T=T)
else:
    print(f"refused: {result.reason[0]}")  # T_target_source then holds the likeliest pose, which is not trusted
