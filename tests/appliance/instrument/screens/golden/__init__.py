"""Pictures of every screen as they should be: the scenes, their pictures, and the command that draws them again."""
