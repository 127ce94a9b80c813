"""How good a rendered drive is: figures and pictures, against recorded frames or against a street's truth."""
