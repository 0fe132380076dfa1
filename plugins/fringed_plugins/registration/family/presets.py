"""The methods of the literature by name: what each is made of, and its paper.

Owns the table alone. The thesis (section 4.6) reviews them; its own is `icpif`.
"""

from __future__ import annotations

from fringed_plugins.registration.family.acceleration import Anderson, Extrapolation
from fringed_plugins.registration.family.describing import Neighbourhoods
from fringed_plugins.registration.family.matching import InvariantFeatures, NormalShooting, Projective
from fringed_plugins.registration.family.method import Method, Stop
from fringed_plugins.registration.family.minimising import (
    PlaneToPlane,
    PointToPlane,
    PointToPoint,
    Scaled,
    Symmetric,
)
from fringed_plugins.registration.family.rejection import (
    Adaptive,
    Boundary,
    Consensus,
    Distance,
    LeastMedian,
    Normals,
    OneToOne,
    Robust,
    Sigmas,
    Trimmed,
)
from fringed_plugins.registration.family.selection import (
    Curvature,
    Everything,
    NormalSpace,
    Random,
    Uniform,
)
from fringed_plugins.registration.family.weighting import ByDistance, ByNoise, ByNormals, Tukey

CONTROL_POINTS = 2500

_ALL = (
    Method(
        "besl-mckay", "ICP", "Besl & McKay: A method for registration of 3-D shapes, PAMI 1992",
        minimise=PointToPoint("unit-quaternion"),
    ),
    Method(
        "besl-mckay-accelerated", "accelerated ICP", "Besl & McKay 1992, section IV-C",
        minimise=PointToPoint("unit-quaternion"), accelerate=Extrapolation(),
    ),
    Method(
        "chen-medioni", "point to plane along normals",
        "Chen & Medioni: Object modelling by registration of multiple range images, IVC 1992",
        select=Uniform(CONTROL_POINTS, whole=True), match=NormalShooting(), reject=(Boundary(), Sigmas()),
        minimise=PointToPlane(),
    ),
    Method(
        "zhang", "adaptive limit", "Zhang: Iterative point matching for registration of free-form curves, IJCV 1994",
        select=Uniform(CONTROL_POINTS), reject=(Adaptive(),), minimise=PointToPoint("dual-quaternion"),
    ),
    Method(
        "icpif", "the thesis's method: invariant features, adaptive rejection, dual quaternions",
        "thesis, section 4.4; Sharp, Lee, Wehe 2002; Zhang 1994; Walker, Shao, Volz 1991",
        select=Uniform(CONTROL_POINTS, whole=True), match=InvariantFeatures(), reject=(Boundary(), Adaptive()),
        minimise=PointToPoint("dual-quaternion"), start="principal-axes",
    ),
    Method(
        "sharp", "ICP with invariant features",
        "Sharp, Lee, Wehe: ICP registration using invariant features, PAMI 2002",
        select=Everything(whole=True), match=InvariantFeatures(), minimise=PointToPoint("unit-quaternion"),
    ),
    Method(
        "icpif-moments", "the thesis's method with moment invariants",
        "Sharp, Lee, Wehe 2002; Sadjadi & Hall: Three-dimensional moment invariants, PAMI 1980; thesis, section 4.4",
        describe=Neighbourhoods("moments"), select=Uniform(CONTROL_POINTS, whole=True), match=InvariantFeatures(),
        reject=(Boundary(), Adaptive()), minimise=PointToPoint("dual-quaternion"), start="principal-axes",
    ),
    Method(
        "icpif-harmonics", "the thesis's method with invariants of spherical harmonics",
        "Sharp, Lee, Wehe 2002; Burel & Henocq: Three-dimensional invariants and their application to object "
        "recognition, SP 1995; thesis, section 4.4",
        describe=Neighbourhoods("harmonics"), select=Uniform(CONTROL_POINTS, whole=True), match=InvariantFeatures(),
        reject=(Boundary(), Adaptive()), minimise=PointToPoint("dual-quaternion"), start="principal-axes",
    ),
    Method(
        "turk-levoy", "zippered meshes", "Turk & Levoy: Zippered polygon meshes from range images, SIGGRAPH 1994",
        select=Uniform(CONTROL_POINTS), reject=(Boundary(), Distance(2.0)), minimise=PointToPoint("unit-quaternion"),
    ),
    Method(
        "masuda-yokoya", "random samples and least median of squares",
        "Masuda & Yokoya: A robust method for registration and segmentation of multiple range images, CVIU 1995",
        select=Random(400), reject=(LeastMedian(),), minimise=PointToPoint("svd"), stop=Stop(still=1e-3),
    ),
    Method(
        "lmeds", "robust ICP by least median of squares",
        "Trucco, Fusiello, Roberto: Robust motion and correspondence of noisy 3-D point sets, PRL 1999",
        select=Uniform(CONTROL_POINTS), reject=(LeastMedian(),), minimise=PointToPoint("svd"), stop=Stop(still=1e-3),
    ),
    Method(
        "random", "other samples in each iteration",
        "Masuda, Sakaue, Yokoya: Registration and integration of multiple range images for 3-D model construction, "
        "ICPR 1996",
        select=Random(CONTROL_POINTS), reject=(Boundary(), Sigmas()), minimise=PointToPoint("svd"),
        stop=Stop(still=1e-3),
    ),
    Method(
        "picky", "one partner each", "Zinsser, Schmidt, Niemann: A refined ICP algorithm, ICIP 2003",
        select=Uniform(CONTROL_POINTS), reject=(OneToOne(), Sigmas(2.5)), minimise=PointToPoint("unit-quaternion"),
        accelerate=Extrapolation(),
    ),
    Method(
        "trimmed", "trimmed ICP",
        "Chetverikov, Stepanov, Krsek: Robust Euclidean alignment of 3-D point sets, IVC 2005",
        select=Uniform(CONTROL_POINTS), reject=(Trimmed(),), minimise=PointToPoint("unit-quaternion"),
    ),
    Method(
        "normal-space", "samples even in normals",
        "Rusinkiewicz & Levoy: Efficient variants of the ICP algorithm, 3DIM 2001",
        select=NormalSpace(CONTROL_POINTS), reject=(Boundary(), Normals(45.0), Sigmas()), minimise=PointToPlane(),
    ),
    Method(
        "curvature-space", "samples of strong curvature", "Rusinkiewicz & Levoy 2001, by curvature instead of normals",
        select=Curvature(CONTROL_POINTS), reject=(Boundary(), Normals(45.0), Sigmas()), minimise=PointToPlane(),
    ),
    Method(
        "projective", "projection instead of search",
        "Blais & Levine: Registering multiview range data, PAMI 1995; Rusinkiewicz & Levoy 2001",
        select=Uniform(CONTROL_POINTS, whole=True), match=Projective(), reject=(Boundary(), Normals(45.0), Sigmas()),
        minimise=PointToPlane(),
    ),
    Method(
        "godin", "weights by distance", "Godin, Rioux, Baribeau: Three-dimensional registration, SPIE 1994",
        select=Uniform(CONTROL_POINTS), reject=(Boundary(), Sigmas()), weigh=ByDistance(), minimise=PointToPoint("svd"),
    ),
    Method(
        "compatible-normals", "weights by normals", "Godin, Rioux, Baribeau 1994; Rusinkiewicz & Levoy 2001",
        select=Uniform(CONTROL_POINTS, whole=True), reject=(Boundary(), Normals(45.0), Sigmas()), weigh=ByNormals(),
        minimise=PointToPoint("svd"),
    ),
    Method(
        "scaling", "scaling ICP",
        "Du, Zheng, Xiong, Ying, Xue: Scaling iterative closest point algorithm for registration of m-D point sets, "
        "JVCIR 2010",
        select=Uniform(CONTROL_POINTS), reject=(Boundary(), Sigmas()), minimise=Scaled(),
    ),
    Method(
        "ransac", "outliers by consensus", "Fischler & Bolles 1981 within ICP, as the thesis reviews it",
        select=Uniform(CONTROL_POINTS), reject=(Boundary(), Consensus()), minimise=PointToPoint("svd"),
        stop=Stop(still=1e-3),
    ),
    Method(
        "gicp", "plane to plane with the sensor's covariances",
        "Segal, Haehnel, Thrun: Generalized-ICP, RSS 2009",
        select=Uniform(CONTROL_POINTS, whole=True), reject=(Boundary(), Sigmas()), minimise=PlaneToPlane(),
    ),
    Method(
        "symmetric", "symmetric objective", "Rusinkiewicz: A symmetric objective function for ICP, TOG 2019",
        select=Uniform(CONTROL_POINTS, whole=True), reject=(Boundary(), Normals(45.0), Robust()), weigh=Tukey(),
        minimise=Symmetric(),
    ),
    Method(
        "noise-weighted", "symmetric objective, weights by the sensor's variance",
        "Rusinkiewicz 2019 with the variance of each point",
        select=Uniform(CONTROL_POINTS, whole=True), reject=(Boundary(), Normals(45.0), Robust()), weigh=ByNoise(),
        minimise=Symmetric(),
    ),
    Method(
        "anderson", "ICP with Anderson's mixing",
        "Zhang, Yao, Deng: Fast and robust iterative closest point, PAMI 2021",
        minimise=PointToPoint("svd"), accelerate=Anderson(),
    ),
)  # fmt: skip

METHODS: dict[str, Method] = {method.name: method for method in _ALL}
