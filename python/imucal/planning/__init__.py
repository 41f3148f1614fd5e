"""Planning of motions, and prediction of the accuracy of a calibration from them."""
