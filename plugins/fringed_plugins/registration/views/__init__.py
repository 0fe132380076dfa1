"""Many views to one model: what pairs say, and what all surfaces say together.

    motions  small motions on SE(3): logarithm, adjoint, Jacobian, the point about which a covariance turns
    graph    views and registered pairs: trees, loops and what they contradict
    poses    the poses that agree best with all pairs, robustly
    robust   the least squares behind them, on SE(3)
    pairing  two surfaces foot to foot, as normal equations of both views' motions
    holding  steps of many poses, and whether the surfaces hold them
    joint    all poses at once on the surfaces themselves
    closing  all of it, from a chain of views on

Knows nothing of the daemon, of plug-ins or of files.
"""
