def main():
    import sys

    print("ok", sys.argv)
