"""Execution in processes and on clusters, in resumable shards.

Data flow: backends -> configuration_hash -> local_pools -> cluster_pools -> progress ->
script_errors -> shard_store -> shards.
"""
