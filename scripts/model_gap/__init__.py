"""Scripts about loose_env/Gap-v0: evaluation, confusable pairs, training.

Data flow: play -> tables -> figure -> evaluate -> pairs -> train.
"""
