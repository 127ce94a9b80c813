"""How good a rendered drive is: figures and images, against recorded frames or against a street's truth."""
