"""The gradient stage: the relaxed problem in padded batches, from a start to labels."""
