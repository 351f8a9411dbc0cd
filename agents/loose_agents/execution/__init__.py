"""Execution in processes and on clusters, in resumable shards; studies and their command lines.

Data flow: script_errors -> command -> backends -> configuration_hash -> local_pools ->
cluster_pools -> progress -> shard_store -> shards -> study.
"""
