"""What is measured between stations on Earth and a point on the Moon, and how it is predicted."""
