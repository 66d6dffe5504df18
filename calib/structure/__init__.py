"""What a structural model is: affine matrices over named parameters, their geometry, sensors and modes."""
