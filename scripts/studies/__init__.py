"""Scripts behind the studies of the documents: link finding, pose sets, simulation step."""
