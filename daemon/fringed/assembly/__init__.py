"""What joins the daemon's parts: loaders, orders for the simulated rig, start, reload and stop.

Above acquisition, serving, recording and workers, which do not know each other; below `app`, which builds.
"""
