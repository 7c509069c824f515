"""From a rough pose to the noise floor of one shot: hypotheses in the image, then edges below the pixel."""
