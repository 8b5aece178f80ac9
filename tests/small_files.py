"""One small valid file of each text format, and how to read a text as a file."""

from pgti_gtsam import datasets

G2O = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
VERTEX_SE2 2 2 0 0.1
VERTEX_XY 0 1 1
EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400
EDGE_SE2_XY 0 0 1 1 10 0 20
EDGE_SE2 1 2 1 0 0.1 100 1 2 100 3 400
FIX 0
EDGE_SE2 2 0 -2 0 -0.1 100 0 0 100 0 400
LANDMARK2 1 5 0 2 10 1 10
"""
G2O_3D = """\
PARAMS_SE3OFFSET 0 0 0 1 0 0 0.70710678 0.70710678
VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1 0 0 0 0 0 1
VERTEX_TRACKXYZ 0 1 2 1
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40
EDGE_SE3_TRACKXYZ 0 0 0 2 -1 0 10 1 0 20 0 30
EDGE_SE3_PRIORXYZ 1 1 0 0 66 0 0 66 0 33
"""
CHAIN = """\
# without vertices, one edge stored backwards
EDGE_SE2 3 5 1 0 0 1 0 0 1 0 1
EDGE_SE2 9 5 -1 0 0 1 0 0 1 0 1
EDGE_SE2 9 3 -2 0 0 1 0 0 1 0 1
"""
TORO = """\
VERTEX2 0 0 0 0
VERTEX2 1 1 0 0
EDGE2 1 0 -1 0 0 10 0 20 30 0 0
BR 0 7 1.5707963267948966 2 0.0349 0.1
EQUIV 1 0
"""
TORO_3D = """\
VERTEX3 0 0 0 0 0 0 0
VERTEX3 1 1 0 0 0 0 0.1
EDGE3 0 1 1 0 0 0 0 0.1 1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 4 0 0 5 0 6
"""
VICTORIA = """\
ODOMETRY 0 1 1 0 0 0.0001 0 0 0.0004 0 0.0009
LANDMARK 1 2 0 2 0.4 0 0.1
ODOMETRY 1 3 1 0 0 0.0001 0 0 0.0001 0 0.0001
"""
SCAN = "ROBOTLASER1 0 -1.57 3.14 0.0087 50.0 0.1 0 4 {ranges} 0 0 0 0 0 0 0 0 0 0 0 0 {time} host 0.1\n"
FLIRTLIB = (
    "VERTEX2 0 0 0 0\n"
    + SCAN.format(ranges="81.91 1.5 0 nan", time=1.0)
    + "VERTEX2 1 1 0 0\n"
    + SCAN.format(ranges="81.91 50 0 -1", time=2.0)
    + "VERTEX2 2 2 0 0\n"
    + SCAN.format(ranges="0.75 3 4 5", time=3.0)
    + """\
#SEQUENTIAL EDGES
EDGE2 0 1 1 0 0 100 0 100 500 0 0
EDGE2 1 2 1 0 0 100 0 100 500 0 0
#LOOP EDGES
EDGE2 0 2 2 0 0 100 0 100 500 0 0
"""
)
CARMEN = "PARAM robot_frontlaser_offset 0.0 nohost 0\n" + "".join(
    f"FLASER 3 {1 + 0.1 * i:.2f} 50.00 2.00 {0.2 * i:.2f} 0 0 {0.2 * i:.2f} 0 0 {10 + i}.0 nohost {i}.0\n"
    for i in range(30)
)
CAMERAS = """\
VERTEX_SE3:EXPMAP 0 0 0 0 0 0 0 1
VERTEX_SE3:EXPMAP 1 1 0 0 0 0 0 1
VERTEX_SIM3:QUAT 2 2 0 0 0 0 0 1 1.5
EDGE_SE3:EXPMAP 0 1 1 0 0 0 0 0 1
EDGE_SIM3:QUAT 1 2 1 0 0 0 0 0 1 1.5
"""
PYFG = """\
VERTEX_SE2 0.0 A0 0 0 0
VERTEX_SE2 1.0 A1 2 0 0
VERTEX_XY L0 2 2
EDGE_SE2 1.0 A0 A1 2 0 0 0.04 0 0 0.09 0 0.01
EDGE_SE2_XY 1.0 A1 L0 0 2 0.04 0 0.09
EDGE_RANGE 1.0 A0 L0 2.8284271247461903 0.25
"""
TUM = "".join(f"{10.5 + i} {i} 0 0 0 0 0 1\n" for i in range(4))
KITTI = "".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" for i in range(4))
BAL = "2 1 2\n0 0 1.5 2.5\n1 0 1.5 2.5\n" + "0 0 0 0 0 0 500 0 0\n0 0 0 1 0 0 500 0 0\n" + "0.5 0 -4\n"
TEXTS = {
    "g2o": G2O,
    "g2o in space": G2O_3D,
    "g2o chain": CHAIN,
    "TORO": TORO,
    "TORO in space": TORO_3D,
    "Victoria Park": VICTORIA,
    "FLIRTLib": FLIRTLIB,
    "CARMEN": CARMEN,
    "cameras": CAMERAS,
    "PyFG": PYFG,
    "TUM": TUM,
    "KITTI": KITTI,
    "BAL": BAL,
}


def read_text(folder, text, name="graph.txt"):
    """The dataset in a file with this text."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return datasets.read(path)
