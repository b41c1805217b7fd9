"""Can the robots of a spec be steered apart by one common signal?"""
