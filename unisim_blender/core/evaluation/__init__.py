"""How good a rendered drive is: metrics and images, against recorded frames or against a street's truth."""
