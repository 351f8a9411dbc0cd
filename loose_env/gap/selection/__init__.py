"""Forward selection of effects: screening, candidate fits, acceptance, ranking.

Data flow: screening -> candidate_fits -> negligible -> deletion -> acceptance -> revision ->
forward_selection -> checkpoint_codec -> impacts -> ranking -> reweighted_search.
"""
