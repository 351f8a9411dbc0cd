"""The nominal model, the parameters and effects added to it, hypotheses of several.

Data flow: element_names -> nominal_model -> parameter -> data_starts -> effect -> driven_effect ->
effects -> nominal_parameters -> hypothesis.
"""
