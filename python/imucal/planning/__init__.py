"""Planning of motions and prediction of their accuracy."""
