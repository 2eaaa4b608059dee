"""World time, the thread that moves it on, and the date that the computer believes."""
