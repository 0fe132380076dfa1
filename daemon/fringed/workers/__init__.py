"""Plug-in hosts: the processes that run plug-ins, who gets which job, and what becomes of those that fail.

`dispatch.Dispatcher` decides (pure), `supervisor.Supervisor` keeps the local processes alive, `host` is the
process itself. Nothing is imported here: a worker sets up its process before it loads NumPy.
"""
