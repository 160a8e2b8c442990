"""Monitors on clusters: Spark, Ray and Dask distribute, and the plants of a shard form a fleet.

``residua.cluster.spark`` needs the extra ``spark``, ``residua.cluster.workers`` one of ``ray``, ``dask``, ``workers``.
"""

from residua.facade import hand_on

hand_on(__name__)
