"""The effects that a model can lack, one concept a file; `loose_env.gap.catalogue` lists them."""
